"""Directions, environment pixels and shading frames.

World: right-handed, z up. Environment map of H rows and W columns: row 0 is +z, column W/2 is +x, the
azimuth decreases to the right. Image coordinates `u`, `v` are in [0, 1): u = (column + 0.5) / W and
v = (row + 0.5) / H at pixel centres. Source: docs/reference/conventions.md.
"""

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]


def directions_of_uv(u: Array, v: Array) -> Array:
    """Return the unit directions [*batch, 3] that the image coordinates `u`, `v` [*batch] look along."""
    azimuth = math.pi - 2.0 * math.pi * u
    polar = math.pi * v
    return np.stack(
        [np.cos(azimuth) * np.sin(polar), np.sin(azimuth) * np.sin(polar), np.cos(polar)], axis=-1
    )


def uv_of_directions(directions: Array) -> tuple[Array, Array]:
    """Return image coordinates (`u` in [0, 1), `v` in [0, 1]) of unit `directions` [*batch, 3]."""
    x, y, z = directions[..., 0], directions[..., 1], directions[..., 2]
    u = 0.5 - np.arctan2(y, x) / (2.0 * math.pi)
    # acos loses half the digits near the poles; atan2 does not.
    v = np.arctan2(np.sqrt(x * x + y * y), z) / math.pi
    return u - np.floor(u), v


def pixel_directions(height: int, width: int) -> Array:
    """Return the direction of every pixel centre of a map, [height, width, 3]."""
    v, u = np.meshgrid((np.arange(height) + 0.5) / height, (np.arange(width) + 0.5) / width, indexing="ij")
    return directions_of_uv(u, v)


def pixel_solid_angles(height: int, width: int) -> Array:
    """Return the solid angle of one pixel of every row, sr, [height]; times `width` they sum to 4 pi."""
    edges = np.cos(math.pi * np.arange(height + 1) / height)
    return (2.0 * math.pi / width) * (edges[:-1] - edges[1:])


def rotate_about_z(directions: Array, degrees: float) -> Array:
    """Return `directions` [*batch, 3] turned by +`degrees` about +z (right-handed)."""
    angle = math.radians(degrees)
    cosine, sine = directions.dtype.type(math.cos(angle)), directions.dtype.type(math.sin(angle))
    x, y, z = directions[..., 0], directions[..., 1], directions[..., 2]
    return np.stack([cosine * x - sine * y, sine * x + cosine * y, z], axis=-1)


def dot(a: Array, b: Array) -> Array:
    """Return the dot products [*batch, 1] of vectors [*batch, 3]."""
    return np.einsum("...i,...i->...", a, b)[..., None]


def normalise(vectors: Array) -> Array:
    """Return `vectors` [*batch, 3] with length 1; vectors shorter than 1e-10 stay short instead of NaN."""
    return vectors / np.maximum(np.sqrt(dot(vectors, vectors)), 1e-10)


def frame_axes(normal: Array) -> tuple[Array, Array]:
    """Return tangent and bitangent [*batch, 3] so that (tangent, bitangent, normal) is right-handed.

    The tangent is up x normal, with up = z unless |normal_z| >= 0.9, then y.
    """
    steep = np.abs(normal[..., 2:]) >= 0.9
    up = np.where(steep, np.array([0, 1, 0], normal.dtype), np.array([0, 0, 1], normal.dtype))
    tangent = normalise(np.cross(up, normal))
    return tangent, np.cross(normal, tangent)
