"""Small networks as compiled code reads them, a block of rows at a time.

Activations lie as [feature, STRIDE]; the first BLOCK columns are rows. See `kernels`.
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from lambent_relight.bundle.graphs import Rows
from lambent_relight.compiling import COMPILE_OPTIONS
from lambent_relight.fused import kernels
from lambent_relight.fused.tiles import BLOCK, STRIDE, affine


class Layer(NamedTuple):
    """An affine layer: weight [out, in], bias [out]."""

    weight: Rows
    bias: Rows


class Network(NamedTuple):
    """Hidden layers, one after another."""

    values: Rows
    """Weight [out, in] and bias [out] of every layer, flat."""
    sizes: NDArray[np.int64]
    """Outputs and inputs per layer, [layer, 2]."""
    skip: int
    """The layer before which the network's inputs join again; -1: none."""
    sharpness: np.float32
    """Of the softplus behind every layer; 0 for ReLU."""

    @classmethod
    def of(cls, layers: list[Layer], *, skip: int | None = None, sharpness: float = 0.0) -> "Network":
        """Return `layers` as a network."""
        flat = [array.reshape(-1) for layer in layers for array in layer]
        values = np.concatenate(flat) if flat else np.zeros(0, np.float32)
        sizes = np.array([layer.weight.shape for layer in layers], np.int64).reshape(-1, 2)
        return cls(values, sizes, -1 if skip is None else skip, np.float32(sharpness))

    @property
    def widest(self) -> int:
        """The most rows that one of its activations takes."""
        return int(self.sizes.max()) if len(self.sizes) else 1


def work_space(*networks: Network) -> Rows:
    """Return room for the activations between the layers of any of `networks`, [2, width, STRIDE]."""
    return np.zeros((2, max(network.widest for network in networks), STRIDE), np.float32)


@njit(**COMPILE_OPTIONS)
def run_network(network, inputs, work):
    """Return the activations [width, STRIDE] behind the last layer, a part of `work`.

    Without layers they are `inputs` [width, STRIDE], no part of `work`, which comes from `work_space`.
    """
    offset, source = 0, inputs
    for index in range(len(network.sizes)):
        num_out, num_in = network.sizes[index]
        weight = network.values[offset : offset + num_out * num_in].reshape((num_out, num_in))
        offset += num_out * num_in
        bias = network.values[offset : offset + num_out]
        offset += num_out
        if index == network.skip:
            kernels.copy_rows(inputs, len(inputs), source, num_in - len(inputs))
        target = work[index % 2]
        affine(weight, bias, source, target)
        if network.sharpness > np.float32(0.0):
            kernels.softplus(target[:num_out], network.sharpness)
        else:
            _rectify(target, num_out)
        source = target
    return source


@njit(**COMPILE_OPTIONS)
def _rectify(values, count):
    """Apply ReLU to the first `count` rows of `values`."""
    for i in range(count):
        for r in range(BLOCK):
            values[i, r] = max(values[i, r], np.float32(0.0))
