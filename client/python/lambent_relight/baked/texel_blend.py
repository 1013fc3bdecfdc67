"""Texels of the atlas blended bilinearly at the fragments of a view: no texel is seen as a square.

A place of the atlas lies between four texel centres. Places outside charts hold the nearest covered texel
(`baked.raster.nearest_texel`), and charts lie two texels apart, so that every one of the four is the chart's
own.
"""

import numpy as np
from lambent_compute.compiling import compiled
from lambent_compute.threads import available_threads, for_each
from numpy.typing import NDArray

_PIXELS_PER_TASK = 1 << 13


def blended_texels(
    plane: NDArray[np.int32], uv: NDArray[np.float32], first: NDArray[np.int64]
) -> tuple[NDArray[np.int32], NDArray[np.float32], NDArray[np.int64]]:
    """Return the texels that pixels show, what each counts in its pixel's mean, and where each pixel's begin.

    The fragments [first[i], first[i + 1]) of pixel i count alike; `uv` [fragment, 2] are their places, and
    `plane` [size, size] the texel at every place of the atlas. A pixel's weights sum to one, and none of its
    texels occurs twice.
    """
    count = len(first) - 1
    texel = np.empty(4 * len(uv), np.int32)
    share = np.empty(4 * len(uv), np.float32)
    number = np.zeros(count, np.int64)
    uv = np.ascontiguousarray(uv, np.float32)

    def blend(start: int) -> None:
        _blend(plane, uv, first, start, min(start + _PIXELS_PER_TASK, count), texel, share, number)

    for_each(blend, range(0, count, _PIXELS_PER_TASK), available_threads())
    begin = np.concatenate([[0], np.cumsum(number)]).astype(np.int64)
    place = np.repeat(4 * first[:-1] - begin[:-1], number) + np.arange(begin[-1])
    return texel[place], share[place], begin


def weighted_sums(
    values: NDArray[np.floating],
    texel: NDArray[np.int32],
    share: NDArray[np.float32],
    first: NDArray[np.int64],
) -> NDArray[np.float32]:
    """Return the sums of `values` [row, n] at `texel` times `share`, from first[i] to first[i + 1]."""
    rows = np.ascontiguousarray(values, np.float32).reshape(len(values), -1)
    count = len(first) - 1
    out = np.empty((count, rows.shape[1]), np.float32)

    def add(start: int) -> None:
        _sums(rows, texel, share, first, start, min(start + _PIXELS_PER_TASK, count), out)

    for_each(add, range(0, count, _PIXELS_PER_TASK), available_threads())
    return out


@compiled()
def _blend(plane, uv, first, start, end, texel, share, number):
    size = plane.shape[0]
    half, zero, one, last = np.float32(0.5), np.float32(0.0), np.float32(1.0), np.float32(size - 1)
    for p in range(start, end):
        begin, count = 4 * first[p], 0
        each = one / np.float32(max(first[p + 1] - first[p], 1))
        for f in range(first[p], first[p + 1]):
            x = min(max(uv[f, 0] * np.float32(size) - half, zero), last)
            y = min(max(uv[f, 1] * np.float32(size) - half, zero), last)
            left, top = int(x), int(y)
            fx, fy = x - np.float32(left), y - np.float32(top)
            for corner in range(4):
                right, below = corner & 1, corner >> 1
                weight = each * (fx if right else one - fx) * (fy if below else one - fy)
                if weight <= zero:
                    continue
                chosen = plane[min(top + below, size - 1), min(left + right, size - 1)]
                place = begin
                while place < begin + count and texel[place] != chosen:
                    place += 1
                if place == begin + count:
                    texel[place], share[place] = chosen, zero
                    count += 1
                share[place] += weight
        number[p] = count


@compiled()
def _sums(values, texel, share, first, start, end, out):
    for p in range(start, end):
        for c in range(values.shape[1]):
            out[p, c] = np.float32(0.0)
        for k in range(first[p], first[p + 1]):
            for c in range(values.shape[1]):
                out[p, c] += share[k] * values[texel[k], c]
