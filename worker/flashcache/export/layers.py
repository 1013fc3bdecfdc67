"""Parts of the model as ONNX nodes; each mirrors the torch code that its docstring names, step by step."""

import math
from collections.abc import Sequence
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from torch import Tensor, nn

from flashcache.encoding.hash_grid import HashGrid
from flashcache.encoding.occupancy import Occupancy
from flashcache.export.onnx import GraphBuilder, Value
from flashcache.export.stored_grids import StoredGrid
from flashcache.fields.mlp import Hidden

# A quarter turn in three parts, of which the products with small whole numbers are exact.
_QUARTER_TURN = (1.5703125, 4.837512969970703e-4, 7.549789948768648e-8)
_SINE = (-1.9515295891e-4, 8.3321608736e-3, -1.6666654611e-1)
_COSINE = (2.443315711809948e-5, -1.388731625493765e-3, 4.166664568298827e-2)


def array_of(tensor: Tensor) -> NDArray[np.float32]:
    """Return a tensor's values for a graph."""
    return tensor.detach().cpu().float().numpy()


def norm(graph: GraphBuilder, vectors: Value) -> Value:
    """Return the length [row, 1] of vectors [row, n]."""
    return graph.node("Sqrt", graph.reduce("ReduceSum", vectors * vectors))


def normalise(graph: GraphBuilder, vectors: Value) -> Value:
    """Return unit vectors, as `torch.nn.functional.normalize(eps=1e-8)` does."""
    return vectors / graph.at_least(norm(graph, vectors), 1e-8)


def contract(graph: GraphBuilder, positions: Value, radius: float) -> Value:
    """Return contracted coordinates of [row, 3] (`geometry.contraction.contract`)."""
    with graph.part("contract"):
        scaled = positions / radius
        length = graph.at_least(norm(graph, scaled), 1.0)
        return scaled * ((2.0 - 1.0 / length) / length)


def softplus(graph: GraphBuilder, value: Value, beta: float = 1.0) -> Value:
    """Return log(1 + exp(beta x)) / beta without overflow; "Softplus" is missing in some runtimes."""
    scaled = value * beta if beta != 1.0 else value
    decay = graph.node("Exp", -graph.node("Abs", scaled))
    smooth = graph.node("Relu", scaled) + graph.node("Log", decay + 1.0)
    return smooth / beta if beta != 1.0 else smooth


def affine(graph: GraphBuilder, name: str, weight: Tensor, bias: Tensor, inputs: Value) -> Value:
    """Return inputs [row, n] times weight [m, n] transposed, plus bias [m]."""
    with graph.part(name):
        return graph.node(
            "Gemm",
            inputs,
            graph.weight(f"{name}.weight", array_of(weight)),
            graph.weight(f"{name}.bias", array_of(bias)),
            transB=1,
        )


def linear(graph: GraphBuilder, name: str, layer: nn.Linear, inputs: Value) -> Value:
    """Return a layer's output (`torch.nn.Linear`)."""
    return affine(graph, name, layer.weight, layer.bias, inputs)


def hidden(graph: GraphBuilder, name: str, network: Hidden, inputs: Value) -> Value:
    """Return the last activations of a network (`fields.mlp.Hidden`)."""
    values = inputs
    for index, layer in enumerate(network.layers):
        if index == network.skip_after:
            values = graph.concat([values, inputs])
        values = linear(graph, f"{name}.layers.{index}", cast(nn.Linear, layer), values)
        with graph.part(f"{name}.layers.{index}"):
            if network.softplus_beta is None:
                values = graph.node("Relu", values)
            else:
                values = softplus(graph, values, network.softplus_beta)
    if network.skip_after == len(network.layers):
        values = graph.concat([values, inputs])
    return values


def positional_encoding(graph: GraphBuilder, values: Value, num_frequencies: int) -> Value:
    """Return [v, sin(2^j v), cos(2^j v)] (`encoding.directional.positional_encoding`)."""
    if num_frequencies == 0:
        return values
    with graph.part("positional_encoding"):
        scaled = graph.concat([values * 2.0**octave for octave in range(num_frequencies)])
        return graph.concat([values, *sine_and_cosine(graph, scaled)])


def sine_and_cosine(graph: GraphBuilder, angles: Value) -> tuple[Value, Value]:
    """Return both, within 1e-7 for angles up to 1000; "Sin" and "Cos" are 1000 times coarser on WebGPU.

    An angle is a whole number of quarter turns and a rest of at most an eighth, for which polynomials are
    exact to float32 (those of the Cephes library). Quarter turns choose between the two and the sign.
    """
    quarters = graph.node("Floor", angles * (2.0 / math.pi) + 0.5)
    rest = angles
    for part in _QUARTER_TURN:
        rest = rest - quarters * part
    square = rest * rest
    sine = ((square * _SINE[0] + _SINE[1]) * square + _SINE[2]) * square * rest + rest
    cosine = ((square * _COSINE[0] + _COSINE[1]) * square + _COSINE[2]) * square * square
    cosine = cosine - square * 0.5 + 1.0
    halves = graph.node("Floor", quarters * 0.5)
    odd = quarters - halves * 2.0
    difference = cosine - sine
    return (
        _signed(graph, halves, sine + odd * difference),
        # A cosine is the sine a quarter turn later: half turns advance where the quarters are odd.
        _signed(graph, halves + odd, cosine - odd * difference),
    )


def _signed(graph: GraphBuilder, halves: Value, values: Value) -> Value:
    """Return the values, negated where the whole number of half turns is odd."""
    return values * (1.0 - (halves - graph.node("Floor", halves * 0.5) * 2.0) * 2.0)


def hash_grid(graph: GraphBuilder, name: str, grid: HashGrid | Occupancy | StoredGrid, z: Value) -> Value:
    """Return the features [row, levels * features] of [row, 3] (`kernels.layout` has the formula).

    Works on all levels at once and on the 8 corners one by one. Each corner is one "Gather" of
    [row, levels, features], seen as [row, levels * features]; the positions between voxels [row, levels] are
    repeated to that width by a product with a 0/1 matrix, which is exact and faster than broadcasting along
    the short last axis. Rows are 32-bit integers and cannot overflow (`kernels.layout`).
    """
    with graph.part(name):
        return _grid_features(graph, name, grid, z)


def _grid_features(
    graph: GraphBuilder, name: str, grid: HashGrid | Occupancy | StoredGrid, z: Value
) -> Value:
    levels, num_features = grid.layout.levels, grid.layout.num_features

    def per_level(values: Sequence[float | int], kind: Any = np.float32) -> NDArray[Any]:
        return np.array([values], kind)

    scale = per_level([level.resolution / (2.0 * grid.layout.half_extent) for level in levels])
    largest = per_level([level.resolution - 1.0 for level in levels])
    num_rows = per_level([level.num_rows for level in levels], np.int32)
    first_row = per_level([level.first_row for level in levels], np.int32)
    multipliers = (
        None,
        per_level([level.multiplier_y for level in levels], np.int32),
        per_level([level.multiplier_z for level in levels], np.int32),
    )
    repeat = np.kron(np.eye(len(levels)), np.ones((1, num_features))).astype(np.float32)
    fractions, base = [], None
    for axis, multiplier in enumerate(multipliers):
        u = graph.at_least(graph.column(z, axis) * scale + 0.5 * largest, 0.0)
        u = graph.minimum(u, largest)
        cell = graph.minimum(graph.node("Floor", u), largest - 1.0)
        fractions.append(graph.node("MatMul", u - cell, repeat))
        whole = graph.node("Cast", cell, to=6)
        term = whole if multiplier is None else whole * multiplier
        base = term if base is None else base + term
    assert base is not None
    table = array_of(grid.table) * np.float32(grid.output_scale)
    corners = []
    for corner in range(8):
        x, y, w = corner & 1, corner >> 1 & 1, corner >> 2
        offset = [x + y * level.multiplier_y + w * level.multiplier_z for level in levels]
        row = base + per_level(offset, np.int32) if corner else base
        row = row - (row / num_rows) * num_rows + first_row
        values = graph.rows_of_table(f"{name}.table", table, row)
        corners.append(graph.reshape(values, -1, len(levels) * num_features))
    for fraction in fractions:
        corners = [a + fraction * (b - a) for a, b in zip(corners[::2], corners[1::2], strict=True)]
    return corners[0]
