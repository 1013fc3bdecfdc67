"""Stage two learns gloss: of a glossy ball and one of metal, whose shape and light are known."""

from dataclasses import replace

import pytest
import torch
from flashcache.config import Config, DistilConfig, Rates
from flashcache.data.ray_batches import TrainingPixels
from flashcache.presets import fast
from flashcache.training.stage_two import StageTwo
from support.lit_balls import ALPHA, METALNESS, balls_model, in_highlights, lit_balls


def learned(config: Config) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the mean perceptual roughness and metalness of both balls after stage two, without a polish.

    The NeRF cache is frozen and knows the balls; all that concerns materials is that of `config`.
    """
    scene = lit_balls()
    model = balls_model(scene, config.model)
    settings = replace(
        config.stage_two,
        num_steps=600,
        num_rays=192,
        warmup_steps=60,
        normal_weight=0.0,
        cache_rates=Rates(grid=0.0, network=0.0),
        distil=DistilConfig(),
    )
    made = StageTwo(model, TrainingPixels(scene, config.pixels, torch.device("cpu")), settings, seed=0)
    while not made.finished:
        made.step()
    with torch.no_grad():
        found = [model.materials(points) for points in in_highlights(scene)]
    roughness = torch.stack([ball.alpha.sqrt().mean() for ball in found])
    return roughness, torch.stack([ball.metalness.mean() for ball in found])


@pytest.mark.long
@pytest.mark.slow
def test_stage_two_learns_roughness_and_metalness_of_a_glossy_ball_and_of_a_metal_one():
    """Before decision 0025: 0.42 and 0.30 for roughness, 0.11 and 0.92 for metalness."""
    roughness, metalness = learned(fast())
    torch.testing.assert_close(roughness, ALPHA[:, 0].sqrt(), atol=0.1, rtol=0.0)
    torch.testing.assert_close(metalness, METALNESS[:, 0], atol=0.09, rtol=0.0)
