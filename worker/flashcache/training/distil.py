"""The end of stage two: only the fast cache trains, on the frozen NeRF cache.

Bundles and pictures under new light use only the fast cache for secondary rays. In joint training
it sees few rays, those of the correction term; here it sees several thousand a step, with the weight on
opacity, which shadows are made of (docs/decisions/0017-distillation.md). The paper has no such step.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from flashcache.config import DistilConfig
from flashcache.data.ray_batches import RayBatch, TrainingPixels
from flashcache.losses.fast_cache import fast_cache_loss
from flashcache.parallel.processes import Processes
from flashcache.parallel.ranks import Ranks
from flashcache.physical.incident import SecondaryRays
from flashcache.physical.model import InverseModel
from flashcache.randomness import generator_for
from flashcache.training.distillation_rays import relit_rays, solid_points
from flashcache.training.joint_losses import in_reach
from flashcache.training.optimiser import Number
from flashcache.training.parts import Parts, mean_over_ranks, numbers

STAGE = "distil"


@dataclass
class DistilLosses:
    """The loss of a part of a batch of the distillation; `flashcache.training.parts.Losses`."""

    config: DistilConfig
    seed: int

    def __call__(
        self, model: InverseModel, batch: RayBatch, step: int, part: int, count: int
    ) -> tuple[Tensor, Number]:
        """Return the loss of one part of a batch, with its value."""
        generator = generator_for(self.seed, STAGE, step, f"part {part}", batch.colour.device)
        with torch.no_grad():
            rays = taught_rays(model, batch, self.config, generator)
            seen = model.ask_nerf(rays, generator) if len(rays) else None
        if seen is None:  # A cache without a surface yet: there is nothing to learn, which is not an error.
            return 0.0 * torch.stack([one.sum() for one in model.fast.parameters()]).sum(), 0.0
        answer = model.fast(rays.origins, rays.directions, rays.light_index)
        loss = fast_cache_loss(
            answer,
            seen,
            in_reach(model, rays),
            model.limits,
            counted=rays.counted,
            opacity_weight=self.config.opacity_weight,
        )
        return loss, numbers({"fast": loss})["fast"]


class Distillation:
    """Adds the gradients of successive batches to those of the fast cache."""

    def __init__(
        self,
        model: InverseModel,
        pixels: TrainingPixels,
        config: DistilConfig,
        *,
        seed: int,
        processes: Processes | None = None,
        ranks: Ranks | None = None,
    ) -> None:
        self.pixels, self.config, self.seed = pixels, config, seed
        losses = DistilLosses(config, seed)
        self.parts = Parts(model, lambda whole: whole.fast, losses, config.num_points, processes, ranks)

    def differentiate(self, step: int) -> Number:
        """Add the gradient of the loss of step `step` to the fast cache's gradients and return the loss."""
        batch = self.pixels.draw(
            self.config.num_points, generator_for(self.seed, STAGE, step, "points", self.pixels.device)
        )
        losses = self.parts.differentiate(batch, step)
        (mean,) = mean_over_ranks([sum(losses) / len(losses)])
        return mean


def taught_rays(
    model: InverseModel, batch: RayBatch, config: DistilConfig, generator: torch.Generator
) -> SecondaryRays:
    """Return the secondary rays that leave the surface where a batch of camera rays meets it."""
    geometry = model.nerf.trace(batch.rays, generator=generator)
    points, solid = solid_points(geometry, batch.rays.directions, batch.light_index, generator)
    alpha = model.materials(points.positions).alpha
    return relit_rays(points, alpha, config.taught, model.limits, generator, solid)
