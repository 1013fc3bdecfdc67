"""Grids and small networks as the arrays that compiled queries read.

Tables are shared with the tensors; the layers of networks, which are small, are copied at every call, for
their values change from step to step.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int
from lambent_compute import blocks
from numpy.typing import NDArray
from torch import Tensor, nn

from flashcache.encoding.hash_grid import HashGrid
from flashcache.encoding.occupancy import Occupancy
from flashcache.fields.mlp import Hidden
from flashcache.kernels import cpu, density_query, lookup


def packed_grid(grid: HashGrid | Occupancy) -> lookup.Grid:
    """Return a grid that shares its table."""
    return lookup.Grid(
        grid.table.detach().numpy(), *cpu.levels_of(grid.layout), np.float32(grid.output_scale)
    )


NO_GRID = lookup.Grid(
    np.zeros((1, 1), np.float32), np.zeros((0, 6), np.uint64), np.zeros((0, 3), np.float32), np.float32(1.0)
)
"""Stands for a grid that does not exist, of the same types."""
_NO_BOX = density_query.Box(False, np.zeros(3, np.float32), np.zeros(3, np.float32))


def packed_occupancy(occupancy: Occupancy | None) -> tuple[lookup.Grid, density_query.Box]:
    """Return the grid of an occupancy and its box, or stand-ins of the same types."""
    if occupancy is None:
        return NO_GRID, _NO_BOX
    half = 0.5 * (occupancy.high - occupancy.low)
    box = density_query.Box(True, (occupancy.low + half).numpy(), half.reciprocal().numpy())
    return packed_grid(occupancy), box


def arrays_of(*tensors: Tensor) -> tuple[NDArray[Any], ...]:
    """Return tensors as the contiguous arrays that compiled code reads."""
    return tuple(tensor.contiguous().numpy() for tensor in tensors)


@dataclass
class Layers:
    """A list of affine layers with their activations, to be packed one after another."""

    parts: list[Tensor] = field(default_factory=list)
    rows: list[tuple[int, int, int, int, int, int]] = field(default_factory=list)
    size: int = 0

    def add(self, layer: nn.Module, activation: int = blocks.LINEAR, *, joins: bool = False) -> "Layers":
        """Add a layer; where it `joins`, the inputs of its network come again behind those of the layer."""
        assert isinstance(layer, nn.Linear)
        return self._add(layer.weight, layer.bias, activation, joins)

    def add_matrix(self, weight: Float[Tensor, "outputs inputs"]) -> "Layers":
        """Add a layer without bias."""
        return self._add(weight, weight.new_zeros(len(weight)), blocks.LINEAR, False)

    def _add(self, weight: Tensor, bias: Tensor, activation: int, joins: bool) -> "Layers":
        outputs, inputs = weight.shape
        end = self.size + inputs * outputs
        self.rows.append((self.size, end, inputs, outputs, activation, int(joins)))
        self.parts += [weight.reshape(-1), bias]
        self.size = end + outputs
        return self

    def add_hidden(self, network: Hidden, head: nn.Module) -> "Layers":
        """Add hidden layers and the layer behind them."""
        activation = blocks.RELU if network.softplus_beta is None else blocks.SOFTPLUS
        for index, layer in enumerate(network.layers):
            self.add(layer, activation, joins=index == network.skip_after)
        return self.add(head, joins=network.skip_after == len(network.layers))

    def packed(self) -> blocks.Networks:
        """Return the layers with the present values of their parameters."""
        return blocks.Networks(torch.cat(self.parts).detach().numpy(), np.array(self.rows, np.int64))

    @property
    def widest(self) -> int:
        """Return the largest number of inputs or outputs of a layer."""
        return max(max(row[2], row[3]) for row in self.rows)


def packed_lights(light_index: Int[Tensor, " rows"], num_lights: int) -> NDArray[np.int64]:
    """Return light indices for compiled code, which does not check them.

    Raises IndexError for a light that does not exist.
    """
    if num_lights > 1 and len(light_index):
        least, most = (int(end) for end in light_index.aminmax())
        if least < 0 or most >= num_lights:
            raise IndexError(f"light indices {least} to {most} for {num_lights} lights")
    (array,) = arrays_of(light_index.to(torch.int64))
    return array
