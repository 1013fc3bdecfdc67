"""Small networks of a bundle as compiled code reads them, a block of rows at a time.

Activations lie as [feature, STRIDE]; the first BLOCK columns are rows. See `kernels`.
"""

from typing import NamedTuple

import numpy as np
from lambent_compute import blocks
from lambent_compute.compiling import inlined
from lambent_compute.tiles import affine
from numpy.typing import NDArray

from lambent_relight.bundle.graphs import Rows
from lambent_relight.fused.kernels import STRIDE


class Layer(NamedTuple):
    """An affine layer: weight [out, in], bias [out]."""

    weight: Rows
    bias: Rows


class Network(NamedTuple):
    """Layers, one after another; the first two members are those of `blocks.Networks`."""

    parameters: Rows
    """Weight [out, in] and bias [out] of every layer, flat."""
    layers: NDArray[np.int64]
    """[layer, 6]"""
    sharpness: np.float32
    """Of the softplus behind every layer; 1 where there is none."""

    @classmethod
    def of(cls, layers: list[Layer], *, skip: int | None = None, sharpness: float = 0.0) -> "Network":
        """Return hidden layers with ReLU or softplus; the inputs join again before layer `skip`."""
        activation = blocks.SOFTPLUS if sharpness else blocks.RELU
        return cls._of(layers, activation, skip, sharpness or 1.0)

    @classmethod
    def head(cls, layer: Layer) -> "Network":
        """Return a single layer without an activation."""
        return cls._of([layer], blocks.LINEAR, None, 1.0)

    @classmethod
    def _of(cls, layers: list[Layer], activation: int, skip: int | None, sharpness: float) -> "Network":
        flat, rows, offset = [np.zeros(0, np.float32)], [], 0
        for index, (weight, bias) in enumerate(layers):
            outputs, inputs = weight.shape
            rows.append((offset, offset + weight.size, inputs, outputs, activation, index == skip))
            flat += [weight.reshape(-1), bias]
            offset += weight.size + bias.size
        return cls(np.concatenate(flat), np.array(rows, np.int64).reshape(-1, 6), np.float32(sharpness))

    @property
    def widest(self) -> int:
        """The most rows that one of its activations takes."""
        return int(self.layers[:, 2:4].max()) if len(self.layers) else 1


def work_space(*networks: Network) -> Rows:
    """Return room for the activations between the layers of any of `networks`, [2, width, STRIDE]."""
    return np.zeros((2, max(network.widest for network in networks), STRIDE), np.float32)


@inlined()
def run_network(network, inputs, work):
    """Return the activations [width, STRIDE] behind the last layer, a part of `work`.

    Without layers they are `inputs` [width, STRIDE], no part of `work`, which comes from `work_space`.
    """
    return blocks.run(
        network, 0, len(network.layers), network.sharpness, inputs, len(inputs), 0, work[0], work[1]
    )


@inlined()
def run_head(head, inputs, result):
    """Write the outputs of a single layer to the first rows of `result` [any, STRIDE]."""
    affine(head.parameters, head.layers[0], inputs, 0, result, 0, False)
