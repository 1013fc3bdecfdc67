"""One independent estimate of a batch of pixels from K of their points (paper Eqs. 9 and 11)."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from flashcache.caches.nerf_cache import Geometry
from flashcache.config import StageTwoConfig
from flashcache.data.ray_batches import RayBatch
from flashcache.physical.brdf import Materials
from flashcache.physical.estimator import control_variate
from flashcache.physical.light_sampler import VmfMixture
from flashcache.physical.model import InverseModel
from flashcache.physical.shading import Estimate, ShadingPoints
from flashcache.volume.quadrature import PointDraw, draw_points, median_point


@dataclass(frozen=True, slots=True)
class Pass:
    """One independent estimate of a batch of pixels: K shaded points per ray."""

    picture: Float[Tensor, "rays 3"]
    """Premultiplied radiance."""
    estimate: Estimate
    points: ShadingPoints
    materials: Materials
    mixture: VmfMixture | None
    index: Int[Tensor, " points"]
    """Position of each shaded point among all points of the batch."""


def shade(
    model: InverseModel,
    config: StageTwoConfig,
    batch: RayBatch,
    geometry: Geometry,
    generator: torch.Generator,
    *,
    supervise: bool = True,
) -> Pass:
    """Return one estimate of the batch.

    `supervise` traces the exact rays even if the estimate itself omits them, for the losses of the
    fast cache and the light sampler.
    """
    weights = geometry.weights.detach()
    num_rays, num_samples = weights.shape
    if config.points == "depth":
        draw: PointDraw = median_point(weights)
    else:
        u = torch.rand(num_rays, config.points_per_ray, generator=generator, device=weights.device)
        draw = draw_points(weights, u)
    row = num_samples * torch.arange(num_rays, device=weights.device)[:, None]
    index = (draw.index + row).reshape(-1)
    repeats = draw.index.shape[-1]
    points = ShadingPoints(
        positions=geometry.samples.positions.reshape(-1, 3)[index],
        normal=geometry.normal[index],
        omega_o=-batch.rays.directions.repeat_interleave(repeats, dim=0),
        light_index=batch.light_index.repeat_interleave(repeats),
    )
    materials = model.materials(points.positions)
    mixture = None
    if config.estimator.sampler == "vmf":
        mixture = model.light_sampler(points.positions, points.light_index)
    estimate = control_variate(
        points,
        materials,
        nerf=model.nerf_source(generator, jitter=config.secondary_jitter),
        fast=model.fast_source(),
        environment=model.environment,
        mixture=mixture,
        limits=model.limits,
        config=config.estimator,
        generator=generator,
        supervise=supervise,
    )
    picture = (draw.weight[..., None] * estimate.rgb.reshape(num_rays, repeats, 3)).sum(dim=1)
    return Pass(picture, estimate, points, materials, mixture, index)
