"""Bright compact peaks of an environment as directional lights, and the map without them.

A peak's light is what rises above its surroundings: inside a disk of `RADIUS_DEG` about the brightest pixel,
each channel minus its mean over the ring from `RADIUS_DEG` to 1.5 `RADIUS_DEG`, where that is positive. It is
taken out of the map and becomes a light from the centroid of what was taken, so the sum of radiance times
solid angle stays the same; no other light is sought in disk and ring. Peaks with less than `MIN_SHARE` of the
map's energy stay in the map. Brightness of a pixel is the sum of its channels; of equal pixels the first is
taken, in rows from the top.
Source: docs/reference/conventions.md (dominant lights).
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from lambent_core.directions import Array, directions_of_uv, pixel_solid_angles, rotate_about_z
from lambent_core.errors import SettingError
from numpy.typing import NDArray

from lambent_relight.environment.maps import Environment

_MAX_TRIALS = 16
MAX_LIGHTS = 8
RADIUS_DEG = 8.0
"""Angle about the brightest pixel that belongs to a light."""
MIN_SHARE = 0.03
"""Smallest share of the map's energy that is worth a light."""


@dataclass(frozen=True)
class DominantLights:
    """Directional lights, brightest first, and the rest of the environment."""

    directions: NDArray[np.float32]
    """Unit vectors towards the lights, [light, 3], turned as the environment is."""
    radiance_solid_angle: NDArray[np.float32]
    """Irradiance of a surface that faces the light, [light, 3]."""
    residual: Environment
    """The environment without them."""
    radii_rad: NDArray[np.float32]
    """Of even discs that are spread about their middles as the lights are in the map, [light]."""


def energy(radiance: Array) -> NDArray[np.float64]:
    """Return the integral of a map [height, width, 3] over the sphere, per channel [3]."""
    rows = np.sum(radiance, axis=1, dtype=np.float64)
    return pixel_solid_angles(*radiance.shape[:2]) @ rows


def split(environment: Environment, count: int) -> DominantLights:
    """Return up to `count` (0 to 8) lights and the residual; fewer where fewer peaks are worth one."""
    if not 0 <= count <= MAX_LIGHTS:
        raise SettingError("relight.dominant_lights", f"{count} lights", f"use 0 to {MAX_LIGHTS}")
    image = environment.radiance.astype(np.float64)
    total = float(energy(image).sum())
    candidates = image.sum(axis=-1)
    lights: list[tuple[float, Array, Array, float]] = []
    for _ in range(_MAX_TRIALS if count and total > 0.0 else 0):
        peak = int(np.argmax(candidates))
        if len(lights) == count or candidates.flat[peak] <= 0.0:
            break
        window = _disk_and_ring(image.shape[:2], *divmod(peak, image.shape[1]))
        if not window.ring.any():
            break
        disk, ring = window.rows[window.disk], window.rows[window.ring]
        disk_columns, ring_columns = window.columns[window.disk], window.columns[window.ring]
        weights = window.solid_angles[window.ring]
        around = weights @ image[ring, ring_columns] / weights.sum()
        taken = np.maximum(image[disk, disk_columns] - around, 0.0)
        flux = taken * window.solid_angles[window.disk][:, None]
        candidates[disk, disk_columns] = -1.0
        candidates[ring, ring_columns] = -1.0
        if flux.sum() < MIN_SHARE * total:
            continue
        image[disk, disk_columns] -= taken
        centre = flux.sum(axis=1) @ window.directions[window.disk]
        centre /= np.linalg.norm(centre)
        away = flux.sum(axis=1) @ (1.0 - window.directions[window.disk] @ centre) / flux.sum()
        # The mean of 1 - cosine over a small disc is a quarter of its radius squared.
        radius = 2.0 * math.sqrt(max(away, 0.0))
        lights.append((float(flux.sum()), centre, flux.sum(axis=0), radius))
    lights.sort(key=lambda light: -light[0])
    directions = np.array([light[1] for light in lights]).reshape(-1, 3)
    return DominantLights(
        rotate_about_z(directions, environment.rotate_deg).astype(np.float32),
        np.array([light[2] for light in lights], np.float32).reshape(-1, 3),
        replace(environment, radiance=image.astype(np.float32)),
        np.array([light[3] for light in lights], np.float32),
    )


@dataclass(frozen=True)
class _Window:
    """Pixels about a peak, flat, and which of them are in the disk and the ring."""

    rows: NDArray[np.int64]
    columns: NDArray[np.int64]
    directions: Array
    solid_angles: Array
    disk: NDArray[np.bool_]
    ring: NDArray[np.bool_]


def _disk_and_ring(shape: tuple[int, int], row: int, column: int) -> _Window:
    height, width = shape
    reach = math.radians(1.5 * RADIUS_DEG) + math.pi / height
    first = max(math.floor(row - reach / math.pi * height), 0)
    last = min(math.ceil(row + reach / math.pi * height) + 1, height)
    # A circle that holds no pole spans this azimuth to either side; one that does, every column.
    sine = math.sin(math.pi * (row + 0.5) / height)
    inner = math.asin(min(math.sin(reach) / sine, 1.0)) if math.sin(reach) < sine else math.pi
    columns_aside = min(math.ceil(inner / (2.0 * math.pi) * width) + 2, width)
    near = np.arange(column - columns_aside, column + columns_aside + 1) % width
    near = near if len(near) < width else np.arange(width)
    rows, columns = np.repeat(np.arange(first, last), len(near)), np.tile(near, last - first)
    directions = directions_of_uv((columns + 0.5) / width, (rows + 0.5) / height)
    centre = directions_of_uv(np.array((column + 0.5) / width), np.array((row + 0.5) / height))
    cosine = directions @ centre
    # The peak itself always belongs, however coarse the map.
    disk = (cosine >= math.cos(math.radians(RADIUS_DEG))) | ((rows == row) & (columns == column))
    ring = ~disk & (cosine >= math.cos(math.radians(1.5 * RADIUS_DEG)))
    if not ring.any():
        # Pixels are larger than the ring: the nearest ones outside take its place.
        outside = np.sort(cosine[~disk])
        ring = ~disk & (cosine >= (outside[-4:].min() if len(outside) else np.inf))
    return _Window(rows, columns, directions, pixel_solid_angles(height, width)[rows], disk, ring)
