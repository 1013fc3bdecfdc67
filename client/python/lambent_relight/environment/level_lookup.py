"""Compiled interpolation in maps and in their prefiltered levels.

Same rule as `Environment.lookup` inside a map, linear in perceptual roughness between two levels. The
kernel releases the interpreter lock and writes nothing but its output.
"""

import math
from collections.abc import Sequence

import numpy as np
from lambent_compute.compiling import compiled, inlined
from numpy.typing import NDArray


def interpolate_levels(
    levels: Sequence[NDArray[np.float32]],
    directions: NDArray[np.float32],
    roughness: NDArray[np.float32],
    rotate_deg: float,
) -> NDArray[np.float32]:
    """Return radiance [n, 3] of `levels` for unit `directions` [n, 3] and `roughness` [n] in [0, 1]."""
    result = np.empty((len(directions), 3), np.float32)
    last = len(levels) - 1
    place = np.clip(roughness, np.float32(0.0), np.float32(1.0)) * np.float32(last)
    level = np.minimum(place.astype(np.int32), last - 1)
    fraction = place - level
    turn = np.float32(rotate_deg / 360.0)
    # Level after level, so that a kernel only ever sees two maps.
    for index in np.unique(level):
        chosen = np.flatnonzero(level == index)
        _interpolate(levels[index], levels[index + 1], directions, chosen, fraction, turn, result)
    return result


@inlined()
def place_on_map(turn, x, y, z):
    """Return the image coordinates (u, v) of a unit direction on a map turned by the share `turn`."""
    u = np.float32(0.5) - np.float32(math.atan2(y, x)) / np.float32(2.0 * math.pi) + turn
    u -= np.float32(math.floor(u))
    v = np.float32(math.atan2(math.sqrt(x * x + y * y), z)) / np.float32(math.pi)
    return u, v


@inlined()
def map_at(image, u, v):
    """Return the radiance of a map at image coordinates: `Environment.lookup` of one direction."""
    height, width = image.shape[0], image.shape[1]
    column = u * np.float32(width) - np.float32(0.5)
    row = min(max(v * np.float32(height) - np.float32(0.5), np.float32(0.0)), np.float32(height - 1))
    left, top = np.int64(math.floor(column)), np.int64(row)
    across, down = column - np.float32(left), row - np.float32(top)
    left %= width
    right, bottom = (left + 1) % width, min(top + 1, height - 1)
    one = np.float32(1.0)
    a, b = (one - across) * (one - down), across * (one - down)
    c, d = (one - across) * down, across * down
    red = a * image[top, left, 0] + b * image[top, right, 0]
    red += c * image[bottom, left, 0] + d * image[bottom, right, 0]
    green = a * image[top, left, 1] + b * image[top, right, 1]
    green += c * image[bottom, left, 1] + d * image[bottom, right, 1]
    blue = a * image[top, left, 2] + b * image[top, right, 2]
    blue += c * image[bottom, left, 2] + d * image[bottom, right, 2]
    return red, green, blue


@compiled()
def _interpolate(sharp, rough, directions, chosen, fraction, turn, result):
    for point in chosen:
        u, v = place_on_map(turn, directions[point, 0], directions[point, 1], directions[point, 2])
        near, far, blend = map_at(sharp, u, v), map_at(rough, u, v), fraction[point]
        for channel in range(3):
            result[point, channel] = (np.float32(1.0) - blend) * near[channel] + blend * far[channel]
