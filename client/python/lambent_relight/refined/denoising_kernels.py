"""Compiled loops of `lambent_relight.refined.denoising`."""

import math

import numpy as np
from lambent_compute.compiling import compiled, inlined

PATCH = 1
"""Pixels to either side that are compared with their neighbours."""
_LEAST = 1e-4
"""Share of a radiance squared that is always taken for noise, so that nothing is divided by zero."""


@inlined()
def _patch_distance(rgb, variance, covered, row, column, other_row, other_column, strength):
    """Return the squared difference of two patches in units of what their noise explains, 0 if it is less."""
    height, width = covered.shape
    total, count = 0.0, 0
    for i in range(-PATCH, PATCH + 1):
        for j in range(-PATCH, PATCH + 1):
            a, b, c, d = row + i, column + j, other_row + i, other_column + j
            if min(a, b, c, d) < 0 or max(a, c) >= height or max(b, d) >= width:
                continue
            if covered[a, b] <= 0.0 or covered[c, d] <= 0.0:
                continue
            for k in range(3):
                apart = rgb[a, b, k] - rgb[c, d, k]
                own, other = variance[a, b, k], variance[c, d, k]
                # Noise alone makes the square as large as the sum of both variances.
                excess = apart * apart - (own + min(own, other))
                scale = strength * strength * (own + other) + _LEAST * rgb[a, b, k] * rgb[a, b, k] + 1e-12
                total += excess / scale
                count += 1
    return max(total / max(count, 1), 0.0)


@compiled()
def smooth(rgb, variance, features, covered, radius, strength, values, out):
    """Write means of `values` [height, width, n] over the pixels around each to `out`.

    `rgb` and its `variance` [height, width, 3] say which patches are alike, `features` [height, width, m]
    which pixels are, in units of their own widths; `covered` [height, width] is every pixel's weight.
    """
    height, width = covered.shape
    sums = np.empty(values.shape[2])
    for row in range(height):
        for column in range(width):
            for k in range(values.shape[2]):
                out[row, column, k] = values[row, column, k]
            if covered[row, column] <= 0.0:
                continue
            total = 0.0
            sums[:] = 0.0
            for i in range(max(row - radius, 0), min(row + radius + 1, height)):
                for j in range(max(column - radius, 0), min(column + radius + 1, width)):
                    if covered[i, j] <= 0.0:
                        continue
                    apart = 0.0
                    for k in range(features.shape[2]):
                        difference = features[row, column, k] - features[i, j, k]
                        apart += difference * difference
                    if apart > 9.0:
                        continue
                    apart += _patch_distance(rgb, variance, covered, row, column, i, j, strength)
                    weight = math.exp(-apart) * covered[i, j]
                    total += weight
                    for k in range(values.shape[2]):
                        sums[k] += weight * values[i, j, k]
            for k in range(values.shape[2]):
                out[row, column, k] = np.float32(sums[k] / total)
