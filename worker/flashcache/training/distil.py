"""The end of stage two: only the fast cache trains, on the frozen NeRF cache.

Bundles and pictures under new light use only the fast cache for secondary rays. In joint training
it sees few rays, those of the correction term; here it sees several thousand a step, with the weight on
opacity, which shadows are made of (docs/decisions/0017-distillation.md). The paper has no such step.
"""

import torch
from torch import Tensor

from flashcache.config import DistilConfig
from flashcache.data.ray_batches import RayBatch, TrainingPixels
from flashcache.losses.fast_cache import fast_cache_loss
from flashcache.physical.incident import Incident, SecondaryRays
from flashcache.physical.model import InverseModel
from flashcache.randomness import generator_for
from flashcache.training.distillation_rays import relit_rays, solid_points
from flashcache.training.joint_losses import in_reach
from flashcache.training.parts import Parts

STAGE = "distil"


class Distillation:
    """Adds the gradients of successive batches to those of the fast cache."""

    def __init__(
        self, model: InverseModel, pixels: TrainingPixels, config: DistilConfig, *, seed: int
    ) -> None:
        self.pixels, self.config, self.seed = pixels, config, seed
        self.parts = Parts(model, lambda whole: whole.fast, config.num_points)

    def differentiate(self, step: int) -> float:
        """Add the gradient of the loss of step `step` to the fast cache's gradients and return the loss."""
        batch = self.pixels.draw(
            self.config.num_points, generator_for(self.seed, STAGE, step, "points", self.pixels.device)
        )
        found = self.parts.differentiate(lambda model, part: self._loss(model, batch, step, part))
        return sum(found) / len(found)

    def _loss(self, model: InverseModel, batch: RayBatch, step: int, part: int) -> tuple[Tensor, float]:
        generator = generator_for(self.seed, STAGE, step, f"part {part}", self.pixels.device)
        with torch.no_grad():
            rays = taught_rays(model, self.parts.of(batch, part), self.config, generator)
            seen = model.ask_nerf(rays, generator) if len(rays) else None
        if seen is None:  # A cache without a surface yet: there is nothing to learn, which is not an error.
            return 0.0 * torch.stack([one.sum() for one in model.fast.parameters()]).sum(), 0.0
        answer = model.fast(rays.origins, rays.directions, rays.light_index)
        loss = fast_cache_loss(
            Incident(answer.near_radiance, answer.opacity, answer.distance),
            Incident(seen.near_radiance, seen.opacity, seen.distance),
            in_reach(model, rays),
            model.limits,
            opacity_weight=self.config.opacity_weight,
        )
        return loss, float(loss.detach())


def taught_rays(
    model: InverseModel, batch: RayBatch, config: DistilConfig, generator: torch.Generator
) -> SecondaryRays:
    """Return the secondary rays that leave the surface where a batch of camera rays meets it."""
    geometry = model.nerf.trace(batch.rays, generator=generator)
    points = solid_points(geometry, batch.rays.directions, batch.light_index, generator)
    alpha = model.materials(points.positions).alpha
    return relit_rays(points, alpha, config.taught, model.limits, generator)
