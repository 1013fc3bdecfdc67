"""Compiled loops of baked relighting. They release the interpreter lock and write only their outputs."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lambent_relight.compiling import COMPILE_OPTIONS


def pixel_means(
    texel: NDArray[np.int32],
    first: NDArray[np.int64],
    straight: NDArray[np.float32],
    bounced: NDArray[np.float32],
) -> NDArray[np.float32]:
    """Return the means over every pixel's texels of two values per texel [texel, 3], as [pixel, 6]."""
    result = np.empty((len(first) - 1, 6), np.float32)
    _pixel_means(texel, first, straight, bounced, result)
    return result


@njit(**COMPILE_OPTIONS)
def _pixel_means(texel, first, straight, bounced, result):
    for pixel in range(len(first) - 1):
        start, end = first[pixel], first[pixel + 1]
        a0 = a1 = a2 = b0 = b1 = b2 = np.float32(0.0)
        for place in range(start, end):
            t = texel[place]
            a0 += straight[t, 0]
            a1 += straight[t, 1]
            a2 += straight[t, 2]
            b0 += bounced[t, 0]
            b1 += bounced[t, 1]
            b2 += bounced[t, 2]
        share = np.float32(1.0) / np.float32(end - start)
        result[pixel, 0], result[pixel, 1], result[pixel, 2] = a0 * share, a1 * share, a2 * share
        result[pixel, 3], result[pixel, 4], result[pixel, 5] = b0 * share, b1 * share, b2 * share
