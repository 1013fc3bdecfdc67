"""The judge of a light bake: exact answers have no error, whatever the noise, and wrong ones have theirs."""

import numpy as np
import pytest
import torch
from flashcache.config import Rates
from flashcache.evaluation.relighting import MapLight
from flashcache.physical.estimator import DirectionCounts
from flashcache.training.light_bake import LightBake, LightBakeConfig, adaptable
from lambent_asset.light_bake.judge import Errors, judged
from support.bake_scenes import Fog, small_cache

OPACITY, LIGHT = 0.5, 2.0
FEW = DirectionCounts(cosine=1, sampler=1, specular=2)
QUICK = LightBakeConfig(
    num_steps=30, num_points=24, fast=FEW, rates=Rates(grid=2e-2, network=1e-2), final_rate=0.02
)


def furnace(num_steps):
    """Return a bake in white fog (0.97 diffuse, 0.03 in the highlight): rays see `OPACITY` x `LIGHT`."""
    even = MapLight.from_image(np.full((8, 16, 3), LIGHT, np.float32), torch.device("cpu"))
    stage = LightBake(adaptable(small_cache(), 0), Fog(OPACITY, 0.97), even, QUICK, brightness=LIGHT, seed=0)
    for _ in range(num_steps):
        stage.step()
    return stage


def exact(rays):
    return torch.full((len(rays), 3), OPACITY * LIGHT)


def darker(rays):
    return 0.6 * exact(rays)


@pytest.fixture(scope="module")
def adapted():
    return furnace(QUICK.num_steps)


def test_an_adapted_cache_is_better_than_transport_that_is_too_dark(adapted):
    errors = judged(adapted, darker)
    assert errors.transport == pytest.approx(0.4, abs=0.05)
    assert errors.adapted < 0.5 * errors.transport


def test_a_cache_that_has_hardly_learned_is_worse_than_exact_transport():
    stage = furnace(1)
    with torch.no_grad():
        stage.model.decoder_head.bias.add_(1.0)
    errors = judged(stage, exact)
    assert errors.adapted > 0.15
    # Its own light comes back to the judge after three bounces.
    assert errors.transport < 0.5 * errors.adapted


def test_the_noise_of_the_estimates_is_no_error_of_an_answer(adapted):
    # One estimate of a ray is off by a third or so; the judge's 4 x 96 rays with 8 each find less than 8 %.
    assert judged(adapted, exact).transport < 0.08
    assert judged(adapted, exact) == judged(adapted, exact)


def test_without_transport_there_is_nothing_to_compare_with(adapted):
    errors = judged(adapted, None)
    assert errors.transport is None
    assert list(errors.figures("noon")) == ["adapted_error_noon"]
    both = Errors(adapted=0.1, transport=0.2).figures("noon")
    assert both == {"adapted_error_noon": 0.1, "transport_error_noon": 0.2}
