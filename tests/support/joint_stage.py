"""Stage two of the lit sphere with every loss switched on."""

from dataclasses import replace

import torch
from flashcache.config import Config, StageTwoConfig
from flashcache.data.ray_batches import TrainingPixels
from flashcache.losses.clusters import ClusterConfig
from flashcache.losses.metalness import MetalnessPriorConfig
from flashcache.parallel.processes import Processes
from flashcache.physical.model import InverseModel
from flashcache.presets import tiny
from flashcache.training.stage_two import StageTwo
from support.lit_sphere import lit_domain, lit_sphere

SCENE = lit_sphere(num_views=4)
DOMAIN = lit_domain(SCENE)
EVERYTHING = {
    "mask_weight": 1.0,
    "distortion_weight": 0.1,
    "orientation_weight": 0.1,
    "normal_every": 1,
    "normal_rays": 1.0,
    "consistency_weight": 0.1,
    "smoothness_weight": 0.1,
    "clusters": ClusterConfig(weight=0.1, gloss_weight=0.1),
    "gloss_from": 0.0,
    "metalness_prior": MetalnessPriorConfig(weight=0.1),
    "grey_weight": 0.1,
    "tint_weight": 0.1,
    "grid_decay": 1.0,
    "warmup_steps": 0,
    "num_rays": 48,
}


def stage(config: Config | None = None, processes: Processes | None = None, **settings) -> StageTwo:
    """Return stage two with every loss switched on, past an initial state in which heads give zero."""
    config = config or tiny()
    two: StageTwoConfig = replace(config.stage_two, **(EVERYTHING | settings))
    torch.manual_seed(0)
    model = InverseModel(config.model, DOMAIN)
    with torch.no_grad():
        for parameter in model.parameters():
            parameter.add_(0.02 * torch.randn(parameter.shape))
    pixels = TrainingPixels(SCENE, config.pixels, torch.device("cpu"))
    return StageTwo(model, pixels, two, seed=0, processes=processes)


def terms_of_step(made: StageTwo) -> dict[str, torch.Tensor]:
    """Return the weighted losses of the next step, by name, on the whole batch."""
    return made.losses.terms(made.model, made.draw(), made.steps_done)[0]
