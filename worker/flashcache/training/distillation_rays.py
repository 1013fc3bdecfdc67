"""The secondary rays with which a cache is trained, distributed as in relighting."""

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from flashcache.caches.nerf_cache import Geometry
from flashcache.geometry.directions import facing
from flashcache.physical.estimator import DirectionCounts
from flashcache.physical.incident import RayLimits, SecondaryRays
from flashcache.physical.sampling import CosineLobe, GgxLobe
from flashcache.physical.shading import DrawnDirections, ShadingPoints
from flashcache.randomness import uniform
from flashcache.rows import Rows
from flashcache.volume.quadrature import draw_points

SOLID = 0.5
"""Opacity from which a camera ray has met the surface."""


def solid_points(
    geometry: Geometry,
    directions: Float[Tensor, "rays 3"],
    light_index: Int[Tensor, " rays"],
    generator: torch.Generator,
    count: int | None = None,
) -> tuple[ShadingPoints, Bool[Tensor, " points"] | None]:
    """Return one point for each camera ray that meets the surface, at most `count`, drawn by render weight.

    With fixed shapes there is one for every ray, and the mask says which rays meet it; else it is None.
    `directions` are unit, away from the camera; normals are turned towards it. Points are in world space.
    """
    num_rays, num_samples = geometry.weights.shape
    rows = Rows.where(geometry.opacity > SOLID)
    kept = rows.of(torch.arange(num_rays, device=geometry.weights.device))[:count]
    u = uniform((num_rays, 1), generator, geometry.weights.device)
    index = draw_points(geometry.weights, u).index[kept, 0] + num_samples * kept
    omega_o = -directions[kept]
    points = ShadingPoints(
        positions=geometry.samples.positions.reshape(-1, 3)[index],
        normal=facing(geometry.normal[index], omega_o),
        omega_o=omega_o,
        light_index=light_index[kept],
    )
    return points, rows.counted


def relit_rays(
    points: ShadingPoints,
    alpha: Float[Tensor, "points 1"],
    counts: DirectionCounts,
    limits: RayLimits,
    generator: torch.Generator,
    which: Bool[Tensor, " points"] | None = None,
) -> SecondaryRays:
    """Return secondary rays as relighting draws them: around the normal, and around the mirror lobe.

    `alpha` is the GGX roughness; without a light to sample, its directions go to the cosine. Rays of
    points outside of `which` do not count.
    """
    mirror = GgxLobe(points.omega_o, points.normal, alpha)
    return DrawnDirections.draw(
        points,
        [(CosineLobe(points.normal), [counts.cosine + counts.sampler])],
        [(mirror, [counts.specular])],
        True,
        limits,
        generator,
        which,
    ).rays
