import torch
from flashcache.encoding.hash_grid import HashGridConfig
from flashcache.fields.density import DensityConfig, DensityField, NormalConfig, NormalField, derived_normal

RADIUS = 1.5
GRID = HashGridConfig(finest_resolution=32, log2_table_size=12)


def field(softplus_beta: float | None = 10.0) -> DensityField:
    torch.manual_seed(0)
    made = DensityField(DensityConfig(grid=GRID, width=16, softplus_beta=softplus_beta), RADIUS).double()
    with torch.no_grad():
        made.grid.table.uniform_(-0.5, 0.5)
    return made


def positions(count: int = 20, radius: float = 1.0) -> torch.Tensor:
    return radius * torch.randn(count, 3, generator=torch.Generator().manual_seed(2), dtype=torch.float64)


def test_the_gradient_is_that_of_log_density():
    made, x = field(), positions(radius=2.0)
    sample, gradient = made.with_gradient(x)
    step = 1e-6
    for axis in range(3):
        moved = torch.zeros(3, dtype=torch.float64)
        moved[axis] = step
        difference = made.density(x + moved).log() - made.density(x - moved).log()
        torch.testing.assert_close(gradient[:, axis], difference / (2 * step), rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(sample.density, made.density(x))


def test_a_loss_on_the_gradient_trains_grid_and_network():
    made = field()
    _, gradient = made.with_gradient(positions())
    gradient.square().sum().backward()
    reached = {name for name, value in made.named_parameters() if value.grad is not None and value.grad.any()}
    assert {"grid.table", "network.layers.0.weight", "head.weight"} <= reached


def test_the_gradient_is_available_where_nothing_is_trained():
    made = field()
    with torch.no_grad():
        _, gradient = made.with_gradient(positions())
    torch.testing.assert_close(gradient, made.with_gradient(positions())[1].detach())


def test_the_derived_normal_faces_away_from_growing_density():
    normal = derived_normal(torch.tensor([[0.0, 0.0, -50.0]]), floor=4.0)
    torch.testing.assert_close(normal, torch.tensor([[0.0, 0.0, 1.0]]), rtol=0.0, atol=5e-3)


def test_the_derived_normal_of_a_vanishing_gradient_is_short_and_smooth():
    gradient = torch.zeros(1, 3, requires_grad=True)
    normal = derived_normal(gradient, floor=4.0)
    normal.sum().backward()
    assert normal.abs().max() == 0.0
    assert torch.isfinite(gradient.grad).all()


def test_predicted_normals_are_unit_with_and_without_a_grid_of_their_own():
    made, x = field(), positions()
    hidden = made(x).hidden
    for config in (NormalConfig(), NormalConfig(own_grid=GRID, width=8)):
        normal = NormalField(config, hidden.shape[-1], RADIUS).double()(x, hidden)
        torch.testing.assert_close(normal.norm(dim=-1), torch.ones(len(x), dtype=torch.float64))
