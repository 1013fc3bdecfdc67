"""Small networks and what surrounds them, for a block of points or rays.

Activations are [feature, point]. Of a tile's columns the first `tiles.COLUMNS` count.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lambent_compute import functions
from lambent_compute.compiling import inlined
from lambent_compute.tiles import COLUMNS, affine

ONE, TWO = np.float32(1.0), np.float32(2.0)

LINEAR, RELU, SOFTPLUS = 0, 1, 2
"""Activations, column 4 of `Networks.layers`."""


class Networks(NamedTuple):
    """Affine layers, one after another.

    `layers` [layer, 6] holds the offsets of weights and bias in `parameters`, the numbers of inputs and
    outputs, the activation, and whether the network's inputs join again before the layer.
    """

    parameters: NDArray[np.float32]
    layers: NDArray[np.int64]


def padded(count: int) -> int:
    """Return `count` rounded up to whole tiles."""
    return (count + COLUMNS - 1) // COLUMNS * COLUMNS


whole_tiles = inlined()(padded)


@inlined()
def contract(x, y, z, inverse_radius):
    """Return a point in contracted coordinates (Mip-NeRF 360 Eq. 10), in units of the radius."""
    x, y, z = x * inverse_radius, y * inverse_radius, z * inverse_radius
    norm = math.sqrt(x * x + y * y + z * z)
    # A NaN fails the comparison and stays in the product.
    norm = ONE if norm < ONE else norm
    scale = (TWO - ONE / norm) / norm
    return x * scale, y * scale, z * scale


@inlined()
def run(networks, begin, end, sharpness, inputs, num_inputs, column, first, second):
    """Return the tile that holds the outputs of the layers `begin` to `end`, which is `first` or `second`.

    `inputs` [num_inputs or more, any] are read from `column` on. `sharpness` is that of softplus.
    """
    source, place, result, other = inputs, column, first, second
    for index in range(begin, end):
        layer = networks.layers[index]
        if layer[5]:
            width = layer[2] - num_inputs
            for i in range(num_inputs):
                for r in range(COLUMNS):
                    source[width + i, place + r] = inputs[i, column + r]
        affine(networks.parameters, layer, source, place, result, 0, layer[4] == RELU)
        if layer[4] == SOFTPLUS:
            inverse = ONE / sharpness
            for o in range(layer[3]):
                for r in range(COLUMNS):
                    result[o, r] = inverse * functions.softplus(sharpness * result[o, r])
        source, place, result, other = result, 0, other, result
    return source


@inlined()
def encode_frequencies(tile, row, num_channels, num_frequencies):
    """Write sines and cosines of the channels in `tile` at `row` behind them (supplement 2.1)."""
    for octave in range(num_frequencies):
        factor = np.float32(1 << octave)
        for c in range(num_channels):
            sines = row + num_channels * (1 + octave) + c
            cosines = sines + num_channels * num_frequencies
            for r in range(COLUMNS):
                tile[sines, r], tile[cosines, r] = functions.sine_and_cosine(factor * tile[row + c, r])


@inlined()
def copy_rows(source, column, first, count, tile, row):
    """Copy `count` rows of `source` from `first` on, one tile from `column` on, to `tile` at `row`."""
    for i in range(count):
        for r in range(COLUMNS):
            tile[row + i, r] = source[first + i, column + r]
