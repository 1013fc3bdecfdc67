"""Independent estimates of a batch of pixels from K of their points each (paper Eqs. 9 and 11)."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from flashcache.caches.nerf_cache import Geometry
from flashcache.config import StageTwoConfig
from flashcache.data.ray_batches import RayBatch
from flashcache.physical.brdf import Materials
from flashcache.physical.estimator import control_variate
from flashcache.physical.incident import LightSources
from flashcache.physical.light_sampler import VmfMixture
from flashcache.physical.model import InverseModel
from flashcache.physical.shading import Estimate, ShadingPoints
from flashcache.randomness import uniform
from flashcache.volume.quadrature import PointDraw, draw_points, median_point


@dataclass(frozen=True, slots=True)
class Shaded:
    """Independent estimates of a batch of pixels, the passes: K shaded points per ray in each."""

    pictures: Float[Tensor, "passes rays 3"]
    """Premultiplied radiance."""
    estimate: Estimate
    """Of all points: the first one of every ray, then the second ones; the passes one after the other."""
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
    passes: int = 1,
    supervise: bool = True,
    with_gloss: bool = True,
) -> Shaded:
    """Return estimates of the batch that share nothing but the geometry.

    Without `with_gloss`, GGX width and metalness are constants to the estimate where they are not those of
    metal. `supervise` traces the exact rays even if the estimate itself omits them, for the losses of the
    fast cache and the light sampler.
    """
    weights = geometry.weights.detach()
    num_rays, num_samples = weights.shape
    if config.points == "depth":
        drawn = median_point(weights)
        draw = PointDraw(drawn.index.expand(-1, passes), drawn.weight.expand(-1, passes))
    else:
        u = uniform((num_rays, passes * config.points_per_ray), generator, weights.device)
        drawn = draw_points(weights, u)
        draw = PointDraw(drawn.index, passes * drawn.weight)
    row = num_samples * torch.arange(num_rays, device=weights.device)
    index = (draw.index.T + row).reshape(-1)
    repeats = draw.index.shape[-1]
    points = ShadingPoints(
        positions=geometry.samples.positions.reshape(-1, 3)[index],
        normal=geometry.normal[index],
        omega_o=-batch.rays.directions.repeat(repeats, 1),
        light_index=batch.light_index.repeat(repeats),
    )
    materials = model.materials(points.positions)
    mixture = None
    if config.estimator.sampler == "vmf":
        mixture = model.light_sampler(points.positions, points.light_index)
    estimate = control_variate(
        points,
        materials if with_gloss else _gloss_of_metals(materials),
        LightSources(
            model.nerf_source(generator, jitter=config.secondary_jitter),
            model.environment,
            model.limits,
            model.fast_source(),
        ),
        mixture=mixture,
        config=config.estimator,
        generator=generator,
        supervise=supervise,
    )
    radiance = draw.weight.T[..., None] * estimate.rgb.reshape(repeats, num_rays, 3)
    pictures = radiance.reshape(passes, -1, num_rays, 3).sum(dim=1)
    return Shaded(pictures, estimate, points, materials, mixture, index)


def _gloss_of_metals(materials: Materials) -> Materials:
    """Return the materials with gradients to GGX width and metalness where metal is more likely than not.

    What a metal reflects is what shows the light first, and it cannot be fitted with a wrong width.
    """
    metal = materials.metalness.detach() > 0.5
    gloss = (torch.where(metal, part, part.detach()) for part in (materials.alpha, materials.metalness))
    return Materials(materials.albedo, *gloss)
