"""Compiled interpolation in prefiltered levels.

Same rule as `Environment.lookup` inside a level, linear in perceptual roughness between two levels. The
kernel releases the interpreter lock and writes nothing but its output.
"""

import math
from collections.abc import Sequence

import numpy as np
from lambent_compute.compiling import compiled, inlined
from numpy.typing import NDArray

_TAU = 2.0 * math.pi


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


@compiled()
def _interpolate(sharp, rough, directions, chosen, fraction, turn, result):
    for position in range(chosen.shape[0]):
        point = chosen[position]
        x, y, z = directions[point, 0], directions[point, 1], directions[point, 2]
        u = np.float32(0.5) - math.atan2(y, x) / np.float32(_TAU) + turn
        u -= math.floor(u)
        v = math.atan2(math.sqrt(x * x + y * y), z) / np.float32(math.pi)
        blend = fraction[point]
        for channel in range(3):
            result[point, channel] = np.float32(0.0)
        _add_bilinear(sharp, u, v, np.float32(1.0) - blend, result, point)
        _add_bilinear(rough, u, v, blend, result, point)


@inlined()
def _add_bilinear(image, u, v, scale, result, point):
    height, width = image.shape[0], image.shape[1]
    column = u * np.float32(width) - np.float32(0.5)
    row = min(max(v * np.float32(height) - np.float32(0.5), np.float32(0.0)), np.float32(height - 1))
    left, top = np.int64(math.floor(column)), np.int64(row)
    across, down = column - np.float32(left), row - np.float32(top)
    left %= width
    right, bottom = (left + 1) % width, min(top + 1, height - 1)
    before, above = np.float32(1.0) - across, np.float32(1.0) - down
    for channel in range(3):
        upper = image[top, left, channel] * before + image[top, right, channel] * across
        lower = image[bottom, left, channel] * before + image[bottom, right, channel] * across
        result[point, channel] += scale * (upper * above + lower * down)
