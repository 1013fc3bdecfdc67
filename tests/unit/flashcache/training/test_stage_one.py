import math
from dataclasses import replace

import pytest
import torch
from flashcache.data.hull import fit_occupancy
from flashcache.data.ray_batches import TrainingPixels
from flashcache.encoding.occupancy import OccupancyConfig
from flashcache.physical.model import InverseModel
from flashcache.presets import tiny
from flashcache.training.stage_one import StageOne
from support.joint_stage import DOMAIN, SCENE


def stage_one(cells: int = 0, **settings) -> StageOne:
    config = tiny()
    torch.manual_seed(0)
    one = replace(config.stage_one, **({"num_rays": 16} | settings))
    model = InverseModel(replace(config.model, occupancy=OccupancyConfig(cells=cells)), DOMAIN)
    fit_occupancy(model, SCENE)
    pixels = TrainingPixels(SCENE, config.pixels, torch.device("cpu"), model.nerf.occupancy)
    return StageOne(model, pixels, one, seed=0)


def test_the_rates_of_stage_one_rise_along_a_sine_over_the_warm_up():
    made = stage_one(num_steps=1000, warmup_steps=3, final_rate=1.0)
    shares = []
    for _ in range(4):
        made.step()
        shares += {group["lr"] / group["peak"] for group in made.optimiser.param_groups}
    assert shares == pytest.approx([math.sin(math.pi / 6.0), math.sin(math.pi / 3.0), 1.0, 1.0])


def test_radiance_depends_on_direction_only_after_the_share_of_the_steps_that_was_set():
    made = stage_one(num_steps=100, specular_from=0.5, warmup_steps=0)
    reflection = made.model.nerf.appearance.reflection_head.bias
    moved = []
    for step in (49, 50):
        made.steps_done = step
        made.step()
        moved.append(bool(reflection.grad.any()))
    assert moved == [False, True]


@pytest.mark.parametrize("carving_share", [0.0, 1.0])
def test_nothing_is_too_bright_for_a_photograph_that_is_clipped_everywhere(carving_share):
    made = stage_one(num_steps=100, carving_share=carving_share)
    batch = made.pixels.draw(16, torch.Generator().manual_seed(0))
    black = replace(batch, colour=0.0 * batch.colour, coverage=torch.ones(16))
    losses = []
    for clipped in (torch.ones(16, 3, dtype=torch.bool), None):
        _, (terms, _) = made.losses(made.model, replace(black, clipped=clipped), made.steps_done, 0, 1)
        losses.append(terms["carving" if carving_share else "colour"])
    assert losses[1] > losses[0] + 0.05


def test_emptiness_is_looked_for_in_all_cells_that_may_hold_something_and_in_no_other():
    made = stage_one(cells=16)
    occupancy = made.model.nerf.occupancy
    assert occupancy is not None
    occupancy.set(occupancy.low.new_zeros(16, 16, 16) > 0.0)
    occupancy.cells[3:9, 5:7, 2:14] = 1
    points = made.losses.anywhere(made.model, 20_000, torch.Generator().manual_seed(0))
    index = ((points - occupancy.low) / occupancy.size).long()
    counts = torch.zeros(16, 16, 16)
    counts.index_put_(tuple(index.unbind(dim=-1)), torch.ones(len(index)), accumulate=True)
    assert torch.equal(counts > 0.0, occupancy.cells > 0)


def test_without_cells_emptiness_is_looked_for_in_the_whole_box():
    made = stage_one()
    points = made.losses.anywhere(made.model, 20_000, torch.Generator().manual_seed(0))
    torch.testing.assert_close(points.amin(dim=0), torch.tensor(DOMAIN.bounds_min), atol=2e-3, rtol=0.0)
    torch.testing.assert_close(points.amax(dim=0), torch.tensor(DOMAIN.bounds_max), atol=2e-3, rtol=0.0)


@pytest.mark.slow
def test_what_no_photograph_shows_becomes_empty():
    """The middle of an opaque ball: nothing but the prior speaks of it."""
    prior = tiny().stage_one.shape_prior
    inside = 0.1 * torch.randn(200, 3, generator=torch.Generator().manual_seed(0))
    mean = []
    for weight in (0.0, 1.0):
        settings = replace(prior, emptiness_weight=weight)
        made = stage_one(cells=16, num_rays=128, num_steps=120, shape_prior=settings)
        while not made.finished:
            made.step()
        with torch.no_grad():
            mean.append(float(made.model.nerf.density.density(inside).mean()))
    assert mean[1] < 0.5 * mean[0]
