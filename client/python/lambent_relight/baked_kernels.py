"""Compiled loops of baked relighting. They release the interpreter lock and write only their outputs."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lambent_relight.compiling import COMPILE_OPTIONS

Rows = NDArray[np.float32]


def shade_pixels(
    places: tuple[NDArray[np.int32], NDArray[np.int64], NDArray[np.int32]],
    light: tuple[Rows, Rows, Rows],
    lobes: tuple[Rows, Rows, Rows],
) -> tuple[Rows, Rows, Rows, Rows]:
    """Return diffuse direct, diffuse indirect, specular direct and specular indirect radiance, [pixel, 3].

    `places`: texels of all pixels, where each pixel's begin, the coarse texel of each texel. `light`:
    irradiance per texel and per coarse texel, prefiltered radiance per pixel. `lobes`: factors per pixel of
    diffuse, free and surrounded reflection (`lambent_relight.baked.Lobes`).
    """
    shape = (len(places[1]) - 1, 3)
    out = tuple(np.empty(shape, np.float32) for _ in range(4))
    _shade_pixels(*places, *light, *lobes, *out)
    return out


@njit(**COMPILE_OPTIONS)
def _shade_pixels(
    texel, first, coarse, straight, bounced, prefiltered, diffuse, free, around, dd, di, sd, si
):
    zero = np.float32(0.0)
    for pixel in range(len(first) - 1):
        start, end = first[pixel], first[pixel + 1]
        a0 = a1 = a2 = b0 = b1 = b2 = np.float32(0.0)
        for place in range(start, end):
            t = texel[place]
            c = coarse[t]
            a0 += straight[t, 0]
            a1 += straight[t, 1]
            a2 += straight[t, 2]
            b0 += bounced[c, 0]
            b1 += bounced[c, 1]
            b2 += bounced[c, 2]
        share = np.float32(1.0) / np.float32(end - start)
        a0, a1, a2 = max(a0 * share, zero), max(a1 * share, zero), max(a2 * share, zero)
        b0, b1, b2 = max(b0 * share, zero), max(b1 * share, zero), max(b2 * share, zero)
        dd[pixel, 0], di[pixel, 0] = diffuse[pixel, 0] * a0, diffuse[pixel, 0] * b0
        dd[pixel, 1], di[pixel, 1] = diffuse[pixel, 1] * a1, diffuse[pixel, 1] * b1
        dd[pixel, 2], di[pixel, 2] = diffuse[pixel, 2] * a2, diffuse[pixel, 2] * b2
        si[pixel, 0], si[pixel, 1], si[pixel, 2] = (
            around[pixel, 0] * b0,
            around[pixel, 1] * b1,
            around[pixel, 2] * b2,
        )
        for channel in range(3):
            sd[pixel, channel] = free[pixel, channel] * prefiltered[pixel, channel]
