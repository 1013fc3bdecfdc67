"""Ambient occlusion of a surface from rays."""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from lambent_asset.mesh.atlas import any_perpendicular, unit
from lambent_asset.textures.surface import AtlasSurface
from lambent_asset.transport.transport_rays import SecondaryRays

Rows = NDArray[np.float32]
NEIGHBOURS = 8
"""Measured texels that one between them takes its value from."""
TURN = 6.0
"""Distances between measured texels that a normal turned by one radian is worth."""
CHUNK_POINTS = 1024


def bake_occlusion(
    surface: AtlasSurface,
    secondary: SecondaryRays,
    *,
    origin_offset: float,
    num_points: int,
    num_rays: int,
) -> Rows:
    """Return for each covered texel the share of cosine-weighted directions in which it sees the open, 0..1.

    It is measured at `num_points` texels spread over the atlas and taken between them from neighbours in
    space that face the same way. `secondary` says what rays meet that begin `origin_offset` (scene units)
    above the surface.
    """
    count = len(surface.texel_index)
    chosen = _spread_out(surface, num_points)
    normals = surface.texel_normals[chosen]
    origins = surface.positions[chosen] + np.float32(origin_offset) * normals
    measured = np.empty(len(chosen), np.float32)
    for start in range(0, len(chosen), CHUNK_POINTS):
        part = slice(start, start + CHUNK_POINTS)
        directions = cosine_directions(normals[part], num_rays, first=start)
        rays = np.repeat(origins[part], num_rays, axis=0)
        hidden, _ = secondary(rays, directions.reshape(-1, 3))
        measured[part] = 1.0 - hidden.reshape(-1, num_rays).mean(axis=1).clip(0.0, 1.0)
    if len(chosen) == count:
        return measured
    return _between(surface, chosen, measured)


def cosine_directions(normals: Rows, num_rays: int, *, first: int = 0) -> Rows:
    """Return unit directions [point, ray, 3] around `normals`, cosine-weighted.

    A Fibonacci spiral on the disc, turned by another angle at each point (golden ratio; points are counted
    from `first`), so that neighbours average out each other's errors.
    """
    k = np.arange(num_rays) + 0.5
    turn = 2.0 * math.pi * ((first + np.arange(len(normals))) * 0.6180339887498949 % 1.0)
    radius, angle = np.sqrt(k / num_rays), k * math.pi * (3.0 - math.sqrt(5.0))
    angle = angle[None] + turn[:, None]
    height = np.sqrt(1.0 - radius**2)
    tangent = unit(any_perpendicular(normals))[:, None]
    bitangent = np.cross(normals, tangent[:, 0])[:, None]
    x, y = (radius * np.cos(angle))[..., None], (radius * np.sin(angle))[..., None]
    return (x * tangent + y * bitangent + height[None, :, None] * normals[:, None]).astype(np.float32)


def _spread_out(surface: AtlasSurface, num_points: int) -> NDArray[np.int64]:
    """Return about `num_points` covered texels, spread evenly over the atlas."""
    count = len(surface.texel_index)
    if count <= num_points:
        return np.arange(count)
    rows, columns = np.divmod(surface.texel_index, surface.size)
    # Roberts' R2 sequence as a threshold: every share of it is spread evenly over the plane.
    rank = (rows * 0.7548776662466927 + columns * 0.5698402909980532) % 1.0
    return np.flatnonzero(rank < num_points / count)


def _between(surface: AtlasSurface, chosen: NDArray[np.int64], measured: Rows) -> Rows:
    """Return values of all texels as means over near measured ones that face the same way."""
    spacing = float(np.median(cKDTree(surface.positions[chosen]).query(surface.positions)[0]))
    # A turn of the normal counts like a way along the surface.
    places = np.concatenate([surface.positions, TURN * spacing * surface.texel_normals], axis=1)
    away, index = cKDTree(places[chosen]).query(places, k=min(NEIGHBOURS, len(chosen)))
    away, index = away.reshape(len(places), -1), index.reshape(len(places), -1)
    weight = np.exp(-2.0 * (away / np.maximum(away[:, -1:], 1e-9)) ** 2)
    return ((weight * measured[index]).sum(axis=1) / weight.sum(axis=1)).astype(np.float32)
