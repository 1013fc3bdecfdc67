import math
from dataclasses import replace

import pytest
import torch
from flashcache.data.ray_batches import TrainingPixels
from flashcache.physical.model import InverseModel
from flashcache.presets import tiny
from flashcache.training.stage_one import StageOne
from support.joint_stage import DOMAIN, SCENE


def stage_one(**settings) -> StageOne:
    config = tiny()
    torch.manual_seed(0)
    pixels = TrainingPixels(SCENE, config.pixels, torch.device("cpu"))
    one = replace(config.stage_one, num_rays=16, **settings)
    return StageOne(InverseModel(config.model, DOMAIN), pixels, one, seed=0)


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
        _, (terms, _) = made._losses(made.model, replace(black, clipped=clipped), 0)
        losses.append(terms["carving" if carving_share else "colour"])
    assert losses[1] > losses[0] + 0.05
