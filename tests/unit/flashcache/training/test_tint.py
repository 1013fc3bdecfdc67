"""The colour of an object is not taken for that of the light, which photographs alone cannot tell apart."""

from dataclasses import replace

import numpy as np
import torch
from flashcache.data.ray_batches import TrainingPixels
from flashcache.losses.priors import tint_prior
from flashcache.physical.model import InverseModel
from flashcache.presets import tiny
from flashcache.training.stage_two import StageTwo
from lambent_core.scene import Scene, View
from support.lit_sphere import lit_domain, lit_sphere

STEPS = 20
PAINT = np.array([0.9, 1.0, 0.1, 1.0], np.float32)


def yellow_sphere() -> Scene:
    """Return the sphere with hardly any blue in it."""

    def painted(view: View) -> View:
        return replace(view, images={light: image * PAINT for light, image in view.images.items()})

    scene = lit_sphere(num_views=4)
    return replace(scene, train=tuple(map(painted, scene.train)), test=tuple(map(painted, scene.test)))


def tint_after_training(weight: float) -> float:
    """Return the tint of the light after `STEPS` of stage two in which materials and light are learned."""
    scene, config = yellow_sphere(), tiny()
    torch.manual_seed(0)
    model = InverseModel(config.model, lit_domain(scene))
    pixels = TrainingPixels(scene, config.pixels, torch.device("cpu"))
    asked = replace(
        config.stage_two, num_steps=STEPS, warmup_steps=0, grey_weight=0.0, tint_weight=weight, num_rays=32
    )
    made = StageTwo(model, pixels, asked, seed=0)
    for _ in range(STEPS):
        made.step()
    directions = torch.nn.functional.normalize(
        torch.randn(2000, 3, generator=torch.Generator().manual_seed(0)), dim=-1
    )
    with torch.no_grad():
        return float(tint_prior(model.environment(directions, torch.zeros(2000, dtype=torch.long))))


def test_a_yellow_object_is_not_explained_by_yellow_light():
    weight = tiny().stage_two.tint_weight
    assert weight > 0.0
    assert tint_after_training(0.0) > 0.2
    assert tint_after_training(weight) < 0.02
