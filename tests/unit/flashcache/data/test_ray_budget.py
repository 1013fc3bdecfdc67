from dataclasses import replace

import pytest
import torch
from flashcache.data.ray_batches import PixelChoice, TrainingPixels
from flashcache.data.ray_budget import ErrorMap, RayBudget, draw_by_error
from flashcache.errors import ConfigError
from support.lit_sphere import lit_sphere
from support.statistics import assert_mean

SCENE = lit_sphere(num_views=3, side=16)
BUDGET = RayBudget(error_share=0.5, block=8)


def pixels(inside_share: float = 0.75) -> TrainingPixels:
    choice = PixelChoice(inside_share=inside_share, dilation_px=2)
    return TrainingPixels(SCENE, choice, torch.device("cpu"))


def uneven(given: TrainingPixels, budget: RayBudget = BUDGET) -> ErrorMap:
    """Return a map on which one block has a hundred times the error of the others."""
    errors = ErrorMap(budget, given.inside, len(given.pixels))
    block = given.inside[40] // budget.block
    errors.error[block] = 100.0
    return errors


def test_pixels_are_drawn_in_proportion_to_the_error_of_their_block():
    given = pixels()
    errors = uneven(given)
    drawn = errors.draw(40_000, torch.Generator().manual_seed(0))
    assert bool(torch.isin(drawn, given.inside).all())
    rare = given.inside[0]
    for pixel in (given.inside[40], rare):
        expected = errors.density(pixel[None]) / len(given.inside)
        assert_mean((drawn == pixel).double(), float(expected))


def test_densities_are_one_on_average_over_the_candidates():
    given = pixels()
    torch.testing.assert_close(uneven(given).density(given.inside).mean(), torch.tensor(1.0))


@pytest.mark.parametrize("inside_share", [0.0, 0.75])
def test_weights_keep_the_mean_of_any_function_of_the_pixel(inside_share):
    given = pixels(inside_share)
    errors = uneven(given)
    values = torch.rand(len(given.pixels), generator=torch.Generator().manual_seed(1))
    batch = draw_by_error(given, errors, 60_000, torch.Generator().manual_seed(2))
    everywhere, inside = values.double().mean(), values[given.inside].double().mean()
    expected = inside_share * inside + (1.0 - inside_share) * everywhere
    assert_mean(batch.weight.double() * values[batch.pixel].double(), float(expected))
    assert_mean(batch.weight.double(), 1.0)


def test_a_measurement_moves_the_error_of_its_block_only():
    given = pixels()
    errors = ErrorMap(replace(BUDGET, memory=0.75), given.inside, len(given.pixels))
    pair = given.inside[[40, 40]]
    errors.record(pair, torch.tensor([2.0, 4.0]))
    block = int(pair[0]) // 8
    assert float(errors.error[block]) == pytest.approx(0.75 + 0.25 * 3.0)
    assert (errors.error[torch.arange(len(errors.error)) != block] == 1.0).all()


@pytest.mark.parametrize("settings", [{"error_share": 1.0}, {"memory": 1.0}, {"block": 0}])
def test_budgets_that_would_starve_the_rest_are_refused(settings):
    with pytest.raises(ConfigError, match="budget"):
        RayBudget(**settings)
