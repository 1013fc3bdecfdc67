from dataclasses import replace

import pytest
import torch
from flashcache.encoding.hash_grid import HashGridConfig
from flashcache.errors import ConfigError
from flashcache.fields.materials import MaterialConfig, MaterialField

GRID = HashGridConfig(finest_resolution=32, log2_table_size=12)


def field(**settings: float) -> MaterialField:
    torch.manual_seed(0)
    return MaterialField(MaterialConfig(grid=GRID, width=16, **settings), 1.5)


def positions() -> torch.Tensor:
    return torch.randn(50, 3, generator=torch.Generator().manual_seed(1))


def test_a_new_field_gives_the_starting_values_everywhere():
    found = field(metalness_bias=-2.0)(positions())
    start = torch.sigmoid(torch.tensor([-1.0, -1.0, -2.0]))
    for values, expected in zip((found.albedo, found.alpha, found.metalness), start, strict=True):
        assert (values - expected).abs().max() < 2e-3


def test_materials_stay_in_their_range_however_extreme_the_network():
    made = field()
    with torch.no_grad():
        made.grid.table.normal_(0.0, 100.0)
    found = made(positions())
    assert found.alpha.min() >= 1e-4
    for values in (found.albedo, found.alpha, found.metalness):
        assert values.min() >= 0.0
        assert values.max() <= 1.0


def test_the_width_gets_a_share_of_its_gradient_and_its_whole_value():
    full, quarter = field(alpha_gradient=1.0), field(alpha_gradient=0.25)
    for made in (full, quarter):
        made(positions()).alpha.sum().backward()
    torch.testing.assert_close(full(positions()).alpha, quarter(positions()).alpha)
    torch.testing.assert_close(0.25 * full.head.bias.grad, quarter.head.bias.grad)


def test_a_grid_of_their_own_keeps_width_and_metalness_apart_from_albedo():
    made = field(gloss_grid=replace(GRID, finest_resolution=16), metalness_bias=-2.0)
    names = {id(parameter) for parameter in made.gloss.parameters()}
    found = made(positions())
    torch.testing.assert_close(found.metalness.mean(), torch.sigmoid(torch.tensor(-2.0)), atol=2e-3, rtol=0.0)
    found.albedo.square().sum().backward(retain_graph=True)
    assert {id(p) for p in made.parameters() if p.grad is not None and p.grad.any()}.isdisjoint(names)
    made.zero_grad()
    (found.alpha.square() + found.metalness.square()).sum().backward()
    moved = {id(p) for p in made.parameters() if p.grad is not None and p.grad.any()}
    assert moved <= names
    assert id(made.gloss.grid.table) in moved


@pytest.mark.parametrize(("part", "other"), [("alpha", "metalness"), ("metalness", "alpha")])
def test_width_and_metalness_have_features_of_their_own_that_the_other_does_not_read(part, other):
    made = field(gloss_grid=replace(GRID, finest_resolution=16))
    before = made(positions())
    optimiser = torch.optim.Adam(made.gloss.parameters(), lr=0.1)
    for _ in range(2):
        optimiser.zero_grad()
        getattr(made(positions()), part).sum().backward()
        optimiser.step()
    after = made(positions())
    assert (getattr(after, part) < getattr(before, part) - 0.01).all()
    torch.testing.assert_close(getattr(after, other), getattr(before, other))


def test_a_grid_of_their_own_must_be_one_that_a_bundle_can_join_to_the_other():
    for settings in ({"num_features": 4}, {"half_extent": 2.0}, {"output_scale": 10.0}):
        with pytest.raises(ConfigError, match="gloss_grid"):
            MaterialConfig(grid=GRID, gloss_grid=replace(GRID, **settings))
