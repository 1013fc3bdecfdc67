"""Looks up planes of an atlas and pictures at places between their pixels.

Pixel (row, column) of a picture is centred at ((column + 0.5), (row + 0.5)) in pixels, or that divided by the
size in u and v; beyond the outermost centres the outermost pixels are repeated.
"""

import numpy as np
from lambent_compute.compiling import compiled
from lambent_compute.threads import available_threads, for_each
from numpy.typing import NDArray

_ROWS_PER_TASK = 1 << 16


def bilinear(plane: NDArray[np.floating], uv: NDArray[np.floating]) -> NDArray[np.float32]:
    """Return `plane` [height, width, n] at `uv` [count, 2] (shares of its sides), as [count, n]."""
    plane = np.ascontiguousarray(plane, np.float32)
    places = np.asarray(uv, np.float32) * np.array([plane.shape[1], plane.shape[0]], np.float32)
    return _at(_bilinear, plane, places)


def cubic(picture: NDArray[np.floating], places: NDArray[np.floating]) -> NDArray[np.float32]:
    """Return `picture` [height, width, n] at `places` [count, 2] (column, row in pixels), as [count, n].

    Catmull-Rom: it passes through the pixels and keeps more of the finest detail than straight lines
    between them, but may overshoot next to an edge.
    """
    return _at(_cubic, np.ascontiguousarray(picture, np.float32), np.asarray(places, np.float32))


def _at(kernel, picture: NDArray[np.float32], places: NDArray[np.float32]) -> NDArray[np.float32]:
    places = np.ascontiguousarray(places)
    out = np.empty((len(places), picture.shape[2]), np.float32)

    def fill(first: int) -> None:
        part = slice(first, first + _ROWS_PER_TASK)
        kernel(picture, places[part], out[part])

    for_each(fill, range(0, len(places), _ROWS_PER_TASK), available_threads())
    return out


@compiled()
def _bilinear(picture, places, out):
    height, width, channels = picture.shape
    for k in range(places.shape[0]):
        x = min(max(places[k, 0] - np.float32(0.5), np.float32(0.0)), np.float32(width - 1))
        y = min(max(places[k, 1] - np.float32(0.5), np.float32(0.0)), np.float32(height - 1))
        left, top = min(int(x), max(width - 2, 0)), min(int(y), max(height - 2, 0))
        right, bottom = min(left + 1, width - 1), min(top + 1, height - 1)
        fx, fy = x - np.float32(left), y - np.float32(top)
        for c in range(channels):
            upper = picture[top, left, c] + fx * (picture[top, right, c] - picture[top, left, c])
            lower = picture[bottom, left, c] + fx * (picture[bottom, right, c] - picture[bottom, left, c])
            out[k, c] = upper + fy * (lower - upper)


@compiled()
def _cubic(picture, places, out):
    height, width, channels = picture.shape
    half, one, two = np.float32(0.5), np.float32(1.0), np.float32(2.0)
    weights = np.empty((2, 4), np.float32)
    for k in range(places.shape[0]):
        x = min(max(places[k, 0] - half, np.float32(0.0)), np.float32(width - 1))
        y = min(max(places[k, 1] - half, np.float32(0.0)), np.float32(height - 1))
        left, top = int(x), int(y)
        for axis in range(2):
            t = x - np.float32(left) if axis == 0 else y - np.float32(top)
            weights[axis, 0] = half * t * ((two - t) * t - one)
            weights[axis, 1] = half * (t * t * (np.float32(3.0) * t - np.float32(5.0)) + two)
            weights[axis, 2] = half * t * ((np.float32(4.0) - np.float32(3.0) * t) * t + one)
            weights[axis, 3] = half * t * t * (t - one)
        for c in range(channels):
            total = np.float32(0.0)
            for j in range(4):
                row = min(max(top + j - 1, 0), height - 1)
                line = np.float32(0.0)
                for i in range(4):
                    column = min(max(left + i - 1, 0), width - 1)
                    line += weights[0, i] * picture[row, column, c]
                total += weights[1, j] * line
            out[k, c] = total
