"""The NeRF cache's answers to secondary rays with compiled sampling; see `flashcache.kernels.ray_query`.

Radiance is evaluated only where it counts. Random numbers are those of the path through torch.
"""

from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from flashcache.caches.nerf_cache import CacheAnswer, Meeting, NerfCache
from flashcache.fields.compiled_density import add_density, packed_occupancy
from flashcache.fields.packing import Layers, packed_grid
from flashcache.geometry.rays import Rays
from flashcache.kernels import ray_query
from flashcache.kernels.ranges import over_rows
from flashcache.randomness import uniform
from flashcache.volume.proposal_sampling import SECONDARY_CURVE
from flashcache.volume.quadrature import draw_points

NEGLIGIBLE = 1e-7
"""Factor up to which a point's radiance is left out: less than the rounding of what the others add up to."""


class Samples(NamedTuple):
    """The final intervals of rays."""

    weights: Float[Tensor, "rays samples"]
    middles: Float[Tensor, "rays samples"]
    """Distances from the origin, scene units."""


def incident(
    cache: NerfCache,
    rays: Rays,
    light_index: Int[Tensor, " rays"],
    num_colours: int,
    generator: torch.Generator | None,
) -> CacheAnswer:
    """Return the cache's answers to `rays`, which are narrowed already; see `NerfCache.incident`."""
    samples = sample(cache, rays)
    opacity, distance = _extent(samples, rays)
    middles, factors = _drawn(samples, num_colours, generator, sure_from=cache.config.secondary_sure_opacity)
    index = (factors.reshape(-1) > NEGLIGIBLE).nonzero()[:, 0]
    ray = index.div(factors.shape[1], rounding_mode="floor")
    directions = rays.directions[ray]
    positions = rays.origins[ray] + middles.reshape(-1)[index, None] * directions
    hidden = cache.density(positions).hidden
    normal = cache.normals(positions, hidden)
    radiance = cache.appearance(positions, hidden, normal, -directions, light_index[ray]).radiance
    sent = factors.reshape(-1)[index, None] * radiance
    near = rays.origins.new_zeros(factors.numel(), 3).index_copy(0, index, sent)
    return CacheAnswer(near.reshape(*factors.shape, 3).sum(dim=1), opacity, distance)


def meet(cache: NerfCache, rays: Rays, num_points: int, generator: torch.Generator | None) -> Meeting:
    """Return the points that `rays`, which are narrowed already, meet; see `NerfCache.meet`."""
    samples = sample(cache, rays)
    middles, factors = _drawn(samples, num_points, generator)
    positions = rays.at(middles).reshape(-1, 3)
    return Meeting(*_extent(samples, rays), positions, cache.density(positions).hidden, factors)


def sample(cache: NerfCache, rays: Rays) -> Samples:
    """Return the final intervals of secondary rays, without jitter."""
    counts, fields = cache.config.secondary_counts, (*cache.proposals, cache.density)
    layers = Layers()
    settings = tuple(tuple(add_density(layers, field)) for field in fields)
    start, end = (SECONDARY_CURVE.ladder(limit) for limit in (rays.near, rays.far))
    found = Samples(torch.empty(len(rays), counts.final), torch.empty(len(rays), counts.final))
    arguments = (
        *(part.contiguous().numpy() for part in (rays.origins, rays.directions, start, end - start)),
        SECONDARY_CURVE.inverse_constants,
        (counts.first, counts.second, counts.final),
        np.float32(cache.config.exponent),
        tuple(tuple(packed_grid(field.grid)) for field in fields),
        tuple(layers.packed()),
        settings,
        *(tuple(part) for part in packed_occupancy(cache.occupancy)),
        layers.widest,
        *(part.numpy() for part in found),
    )
    over_rows(lambda begin, end: ray_query.sample(begin, end, *arguments), len(rays), ray_query.RAYS)
    return found


def _extent(samples: Samples, rays: Rays) -> tuple[Tensor, Tensor]:
    """Return opacity and mean distance of rays, the far end where nothing is hit."""
    opacity = samples.weights.sum(dim=-1)
    distance = (samples.weights * samples.middles).sum(dim=-1) / opacity.clamp_min(1e-3)
    return opacity, torch.where(opacity < 1e-3, rays.far, distance)


def _drawn(
    samples: Samples, num_points: int, generator: torch.Generator | None, *, sure_from: float = 0.0
) -> tuple[Tensor, Tensor]:
    """Return the distances of all points with their weights, or of `num_points` per ray that are drawn."""
    if not num_points:
        return samples.middles, samples.weights
    u = uniform((len(samples.weights), num_points), generator, samples.weights.device)
    draw = draw_points(samples.weights, u, sure_from=sure_from)
    return samples.middles.gather(-1, draw.index), draw.weight
