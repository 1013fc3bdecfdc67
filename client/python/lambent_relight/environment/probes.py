"""Pictures that show an environment: a chrome ball, a grey ball, the map itself.

The balls are seen from far away at azimuth `from_deg`, z up; at 0 the eye is on +x, with +y to the right,
and `elevation_deg` above the horizontal plane. A chrome ball shows nearly all directions, those behind the
eye in its middle. The grey ball reflects 18 % of the light that falls on it, evenly to all sides and without
shadows.
"""

import math
from dataclasses import dataclass

import numpy as np
from lambent_core.directions import Array, dot, pixel_directions
from lambent_core.errors import SettingError
from numpy.typing import NDArray

from lambent_relight.environment.maps import Environment
from lambent_relight.environment.prefilter import irradiance

GREY = 0.18
"""Albedo of the grey ball."""
_SUBPIXELS = 3
_MAX_SIZE = 4096


@dataclass(frozen=True)
class Ball:
    """A picture of a ball."""

    rgb: NDArray[np.float32]
    """Linear radiance [size, size, 3], the mean over the covered part of a pixel."""
    opacity: NDArray[np.float32]
    """Covered share of a pixel, [size, size, 1]."""


def chrome_ball(
    environment: Environment, size: int, *, from_deg: float = 0.0, elevation_deg: float = 0.0
) -> Ball:
    """Return a perfect mirror ball, `size` pixels wide (2 to 4096)."""
    normals, covered, omega_o = _ball_normals(size, from_deg, elevation_deg)
    mirrored = 2.0 * dot(normals, np.broadcast_to(omega_o, normals.shape)) * normals - omega_o
    return _mean_of_subpixels(environment.lookup(mirrored), covered, size)


def grey_ball(
    environment: Environment, size: int, *, from_deg: float = 0.0, elevation_deg: float = 0.0
) -> Ball:
    """Return a matt ball of albedo 0.18, `size` pixels wide (2 to 4096)."""
    light = Environment(irradiance(environment), environment.rotate_deg)
    return lit_ball(light, size, from_deg=from_deg, elevation_deg=elevation_deg)


def lit_ball(light: Environment, size: int, *, from_deg: float, elevation_deg: float) -> Ball:
    """Return `grey_ball` for a `light` whose map is irradiance over pi already."""
    normals, covered, _ = _ball_normals(size, from_deg, elevation_deg)
    return _mean_of_subpixels(GREY * light.lookup(normals), covered, size)


def upright_map(environment: Environment, height: int) -> NDArray[np.float32]:
    """Return the map in our convention with its rotation applied, [height, 2 height, 3], by interpolation."""
    return environment.lookup(pixel_directions(height, 2 * height))


def _ball_normals(size: int, from_deg: float, elevation_deg: float) -> tuple[Array, NDArray[np.bool_], Array]:
    """Return normals [n, 3] of all sub-pixels, whether they meet the ball [n], and the eye's direction."""
    if not 2 <= size <= _MAX_SIZE:
        raise SettingError("relight.probe_size", f"{size} pixels", f"use 2 to {_MAX_SIZE}")
    side = size * _SUBPIXELS
    place = (np.arange(side) + 0.5) * (2.0 / side) - 1.0
    up, right = (axis.ravel() for axis in np.meshgrid(-place, place, indexing="ij"))
    squared = up * up + right * right
    covered = squared < 1.0
    towards = np.sqrt(np.maximum(1.0 - squared, 0.0))
    scale = 1.0 / np.sqrt(np.maximum(squared, 1.0))
    angle, height = math.radians(from_deg), math.radians(elevation_deg)
    around = np.array([math.cos(angle), math.sin(angle), 0.0])
    aside = np.array([-math.sin(angle), math.cos(angle), 0.0])
    eye = math.cos(height) * around + np.array([0.0, 0.0, math.sin(height)])
    above = -math.sin(height) * around + np.array([0.0, 0.0, math.cos(height)])
    normals = towards[:, None] * eye + (right * scale)[:, None] * aside + (up * scale)[:, None] * above
    return normals, covered, eye


def _mean_of_subpixels(radiance: Array, covered: NDArray[np.bool_], size: int) -> Ball:
    shape = (size, _SUBPIXELS, size, _SUBPIXELS, -1)
    weight = covered[:, None].astype(np.float64)
    total = (radiance * weight).reshape(shape).sum(axis=(1, 3))
    count = weight.reshape(shape).sum(axis=(1, 3))
    rgb = total / np.maximum(count, 1.0)
    return Ball(rgb.astype(np.float32), (count / _SUBPIXELS**2).astype(np.float32))
