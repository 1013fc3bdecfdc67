"""Densities, normals and outgoing radiance from compiled code, against torch."""

import pytest
import torch
from flashcache.fields.appearance import AppearanceField
from flashcache.kernels import dispatch
from support.trained_like import SHAPES, trained_like


def directions(count: int, seed: int) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.nn.functional.normalize(torch.randn(count, 3, generator=generator), dim=-1)


def positions(count: int) -> torch.Tensor:
    return 0.8 * torch.randn(count, 3, generator=torch.Generator().manual_seed(1))


def both(function) -> tuple:
    """Return what compiled code and torch answer."""
    with torch.no_grad():
        compiled = function()
        with dispatch.using("reference"):
            return compiled, function()


@pytest.mark.parametrize("count", [0, 1, 64, 1500])
@pytest.mark.parametrize("cells", [False, True])
def test_densities_and_features_are_those_of_torch(cells, count):
    made = trained_like(cells=cells)
    for field in (made.density, *made.proposals):
        compiled, expected = both(lambda field=field: field(positions(count)))
        torch.testing.assert_close(compiled.density, expected.density, rtol=1e-3, atol=1e-5)
        torch.testing.assert_close(compiled.hidden, expected.hidden, rtol=1e-4, atol=1e-4)


def test_densities_outside_of_the_cells_are_zero():
    made = trained_like()
    with torch.no_grad():
        found = made.density(torch.tensor([[0.0, 0.1, -0.1], [3.0, 0.0, 0.0]]))
    assert (found.density == 0.0).all()


def test_a_logarithm_of_the_density_is_limited():
    made = trained_like(cells=False)
    with torch.no_grad():
        made.density.head.bias.fill_(1e3)
        found = made.density(positions(3)).density
    torch.testing.assert_close(found, torch.full((3,), 70.0).exp(), rtol=1e-5, atol=0.0)


@pytest.mark.parametrize("shape", ["small", "linear normals"])
def test_normals_are_those_of_torch(shape):
    made = trained_like(SHAPES[shape])
    hidden = torch.rand(300, 24, generator=torch.Generator().manual_seed(4))
    compiled, expected = both(lambda: made.normals(positions(300), hidden))
    torch.testing.assert_close(compiled, expected, rtol=0.0, atol=2e-4)
    torch.testing.assert_close(compiled.norm(dim=-1), torch.ones(300))


@pytest.mark.parametrize("with_specular", [False, True])
@pytest.mark.parametrize("num_lights", [1, 3])
@pytest.mark.parametrize("shape", ["small", "joined"])
def test_outgoing_radiance_is_that_of_torch(shape, num_lights, with_specular):
    made, count = trained_like(SHAPES[shape], num_lights).appearance, 333
    hidden = torch.rand(count, 24, generator=torch.Generator().manual_seed(4))
    light = torch.randint(num_lights, (count,), generator=torch.Generator().manual_seed(5))
    inputs = positions(count), hidden, directions(count, 6), directions(count, 7), light
    compiled, expected = both(lambda: made(*inputs, with_specular=with_specular))
    for found, wanted in zip(compiled, expected, strict=True):
        torch.testing.assert_close(found, wanted, rtol=1e-3, atol=1e-4)
    assert bool(compiled.specular.any()) == with_specular


def test_radiance_is_limited():
    made = trained_like().appearance
    with torch.no_grad():
        made.heads.bias.fill_(1e6)
        made.reflection_head.bias.fill_(1e6)
        found = made(
            positions(5),
            torch.rand(5, 24),
            directions(5, 6),
            directions(5, 7),
            torch.zeros(5, dtype=torch.long),
        )
    assert (found.diffuse == 1e4).all()
    assert (found.specular == 1e4).all()
    assert (found.irradiance > 1e5).all()


def test_a_light_that_is_not_there_is_refused():
    made = trained_like(num_lights=2).appearance
    inputs = positions(2), torch.rand(2, 24), directions(2, 6), directions(2, 7)
    with torch.no_grad(), pytest.raises(IndexError, match="light"):
        made(*inputs, torch.tensor([0, -1]))


def test_gradients_are_torchs(monkeypatch):
    monkeypatch.setattr(AppearanceField, "_answer_compiled", None)
    made = trained_like().appearance
    inputs = positions(2), torch.rand(2, 24), directions(2, 6), directions(2, 7)
    assert made(*inputs, torch.zeros(2, dtype=torch.long)).radiance.requires_grad
