"""Indirect light at a texel, under any environment.

A blocked ray ends at a hit point, whose outgoing radiance is linear in the light: its diffuse part by the
irradiance transfer of the nearest texel, its specular part by the environment seen in the mirror direction,
smoothed by the lobe and weakened by what hides it; the rest of the lobe sees the mean of what surrounds
the hit point. Gathering this over all rays, again and again, gives every further bounce: direct -> gather ->
iterate. Source: docs/method.md (relighting); Sloan et al. 2002 (interreflections).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from lambent_relight.baked.transport_kernels import NearestPoint
from lambent_relight.brdf import base_reflectance
from numpy import ndarray

from lambent_asset.transport.transport_rays import CELL, BakedSurface, Occlusion
from lambent_asset.transport.transport_specular import RayHits, mirrored_light

_LEAST_BLOCKED = 0.05
"""Share of the hemisphere that is taken to surround a hit point at least."""

_CONVERGED = 1e-3
"""Iteration ends when mean indirect light grows by less than this share."""


@dataclass(frozen=True, slots=True, eq=False)
class Reflectors:
    """Materials of texels."""

    albedo: Float[ndarray, "texels 3"]
    perceptual_roughness: Float[ndarray, "texels 1"]
    metalness: Float[ndarray, "texels 1"]

    def diffuse(self) -> Float[ndarray, "texels 3"]:
        """Return the diffuse albedo."""
        return (1.0 - self.metalness) * self.albedo

    def base_reflectance(self) -> Float[ndarray, "texels 3"]:
        """Return F0."""
        return base_reflectance(self.albedo, self.metalness)


def indirect_transfer(
    surface: BakedSurface,
    reflectors: Reflectors,
    seen: Occlusion,
    directions: Float[ndarray, "sets directions 3"],
    direct: Float[ndarray, "texels coefficients"],
    visibility: Float[ndarray, "texels _"],
    *,
    origin_offset: float,
    num_bounces: int,
) -> Float[ndarray, "coefficients coarse 3"]:
    """Return the indirect transfer of the texels that stand for blocks.

    `direct` and `visibility` are per texel, coefficients last.
    """
    coarse, parent = surface.blocks
    hits, count = _hits(surface, seen, directions, origin_offset), len(surface.positions)
    gather = hits.gathering(hits.weight, count)
    mirrored, rest = mirrored_light(
        hits,
        surface.normals,
        reflectors.perceptual_roughness[:, 0],
        reflectors.base_reflectance(),
        visibility,
        direct.shape[1],
    )
    # The part of a lobe that sees no sky sees the mean of what surrounds the hit point.
    blocked = 1.0 - direct[hits.texel, 0] / (0.5 * np.sqrt(np.pi))
    rest /= (np.pi * np.maximum(blocked, _LEAST_BLOCKED))[:, None]
    surrounded = [hits.gathering(rest[:, channel], count) for channel in range(3)]
    diffuse = (reflectors.diffuse() / np.pi).astype(np.float32)
    result = np.zeros((direct.shape[1], len(coarse), 3), np.float32)
    for _ in range(num_bounces):
        before = result[0].mean(dtype=np.float64)
        for channel in range(3):
            arriving = result[:, :, channel].T[parent]
            total = gather @ (diffuse[:, channel : channel + 1] * (direct + arriving))
            total += mirrored[:, :, channel] + surrounded[channel] @ arriving
            result[:, :, channel] = total.T
        if abs(result[0].mean(dtype=np.float64) - before) <= _CONVERGED * before:
            break
    return result


def _hits(
    surface: BakedSurface,
    seen: Occlusion,
    directions: Float[ndarray, "sets directions 3"],
    origin_offset: float,
) -> RayHits:
    """Return the rays of the texels that stand for blocks that end at a surface, and where."""
    coarse, positions, normals = surface.blocks[0], surface.positions, surface.normals
    receiver, column = np.nonzero(seen.distance > 0.0)
    texel = coarse[receiver]
    way = directions[seen.set_of_texel[texel], column]
    cosine = np.einsum("ni,ni->n", way, normals[texel])
    # A fully blocked texel traced half of its directions; each then counts twice.
    stored = np.bincount(receiver, minlength=len(coarse))
    blocked = (seen.opacity[coarse] > 12).sum(axis=1)
    width = (CELL * np.maximum(blocked / np.maximum(stored, 1), 1.0))[receiver]
    origin = positions[texel] + origin_offset * normals[texel]
    ends = origin + seen.distance[receiver, column].astype(np.float32)[:, None] * way
    nearest = NearestPoint(positions)(ends)
    weight = seen.opacity[texel, column] / 255.0 * np.maximum(cosine, 0.0) * width
    first = np.concatenate([[0], np.cumsum(stored)]).astype(np.int32)
    return RayHits(first, nearest, weight.astype(np.float32), way)
