"""Reduces maps: the mean over larger pixels, weighted by solid angle."""

import math

import numpy as np
from lambent_core.directions import Array
from numpy.typing import NDArray


def area_mean(image: Array, height: int, width: int) -> NDArray[np.float64]:
    """Return the mean of a map [rows, columns, 3] over the pixels of one with `height` x `width`.

    Pixels count as constant, and parts of pixels with the solid angle of the part, so that the sum of
    radiance times solid angle stays the same. `height` and `width` are at most the map's own.
    """
    rows, columns, channels = image.shape
    edges = np.cos(math.pi * np.arange(rows + 1) / rows)
    place = np.arange(width + 1) * (columns / width)
    whole = np.minimum(np.floor(place).astype(np.int64), columns - 1)
    part = (place - whole)[:, None]
    result = np.empty((height, width, channels))
    for index in range(height):
        top, bottom = math.cos(math.pi * index / height), math.cos(math.pi * (index + 1) / height)
        first, last = index * rows // height, -(-(index + 1) * rows // height)
        overlap = np.minimum(edges[first:last], top) - np.maximum(edges[first + 1 : last + 1], bottom)
        line = np.tensordot(overlap, image[first:last].astype(np.float64), axes=1) / (top - bottom)
        # The integral up to every edge of the new columns, then differences of neighbours.
        before = np.concatenate([np.zeros((1, channels)), np.cumsum(line, axis=0)])
        upto = before[whole] + part * line[whole]
        result[index] = np.diff(upto, axis=0) * (width / columns)
    return result
