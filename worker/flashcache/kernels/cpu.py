"""The encoder as compiled loops for the processor: float32, numba, no OpenMP.

numba's own threading would load a second OpenMP runtime beside torch's, so the kernels release the
interpreter lock and the work is cut by hand: points in the forward pass, levels in the backward pass. Each
row of a gradient is summed by one task in the order of the points, whatever the number of threads, of which
there are as many as torch uses. The loops share memory with the tensors.
The number of features is a constant of the compiled code; with a run-time number the loops are half as fast.
"""

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from lambent_compute.compiling import compiled, inlined
from numpy.typing import NDArray
from torch import Tensor

from flashcache.kernels.layout import GridLayout, level_constants

Array = NDArray[np.float32]
Kernel = Callable[..., Any]

BLOCK = 8192
"""Points per block; a block visits one level after another so that rows and features stay cached."""

TOUCHED_VALUES = 2**18
"""Levels of at most this many values (1 MiB, a core's own cache) are read once from end to end before random
access, if enough points follow: memory is several times faster in order."""

PARALLEL_POINTS = 4096
"""Below this many point-levels per thread a pool costs more than it saves."""


class Levels(NamedTuple):
    """The constants of a layout as arrays, one entry per level (`layout.level_constants`)."""

    counts: NDArray[np.uint64]
    scales: Array


class Kernels(NamedTuple):
    """Compiled loops for one number of features."""

    forward: Kernel
    forward_jacobian: Kernel
    table_gradient: Kernel
    table_gradient_jacobian: Kernel
    position_gradient: Kernel


def encode(
    z: Float[Tensor, "points 3"], table: Float[Tensor, "rows features"], layout: GridLayout
) -> Float[Tensor, "points outputs"]:
    """Return the features of `z`."""
    kernels, levels = _kernels(layout.num_features), levels_of(layout)
    features = np.empty((len(z), layout.num_outputs), np.float32)
    _over_points(kernels.forward, layout, (_array(z), table.numpy(), *levels, features))
    return torch.from_numpy(features)


def encode_with_jacobian(
    z: Float[Tensor, "points 3"], table: Float[Tensor, "rows features"], layout: GridLayout
) -> tuple[Float[Tensor, "points outputs"], Float[Tensor, "points outputs 3"]]:
    """Return the features of `z` and their derivative by `z`."""
    kernels, levels = _kernels(layout.num_features), levels_of(layout)
    features = np.empty((len(z), layout.num_outputs), np.float32)
    jacobian = np.empty((len(z), layout.num_outputs, 3), np.float32)
    _over_points(kernels.forward_jacobian, layout, (_array(z), table.numpy(), *levels, features, jacobian))
    return torch.from_numpy(features), torch.from_numpy(jacobian)


def position_gradient(
    z: Float[Tensor, "points 3"],
    table: Float[Tensor, "rows features"],
    layout: GridLayout,
    features_gradient: Float[Tensor, "points outputs"],
) -> Float[Tensor, "points 3"]:
    """Return the gradient by `z`, given the one by the features."""
    kernels, levels = _kernels(layout.num_features), levels_of(layout)
    gradient = np.empty((len(z), 3), np.float32)
    arguments = (_array(z), table.numpy(), *levels, _array(features_gradient), gradient)
    _over_points(kernels.position_gradient, layout, arguments)
    return torch.from_numpy(gradient)


def add_table_gradient(
    z: Float[Tensor, "points 3"],
    layout: GridLayout,
    features_gradient: Float[Tensor, "points outputs"],
    jacobian_gradient: Float[Tensor, "points outputs 3"] | None,
    gradient: Float[Tensor, "rows features"],
    *,
    overwrite: bool = False,
) -> None:
    """Add the gradient by the table to `gradient`, or write it there.

    `jacobian_gradient` is None where only features were used.
    """
    kernels, levels = _kernels(layout.num_features), levels_of(layout)
    kernel, given = kernels.table_gradient, [_array(features_gradient)]
    if jacobian_gradient is not None:
        kernel, given = kernels.table_gradient_jacobian, [*given, _array(jacobian_gradient)]
    points, sums = _array(z), gradient.numpy()

    def one_level(level: int) -> None:
        le = layout.levels[level]
        if overwrite:
            sums[le.first_row : le.first_row + le.num_rows] = 0.0
        kernel(level, points, *levels, *given, sums)

    # Fine levels first: they take longest, for their rows are far apart.
    order = range(len(layout.levels) - 1, -1, -1)
    num_threads = torch.get_num_threads()
    if num_threads > 1 and len(z) * len(layout.levels) > PARALLEL_POINTS * num_threads:
        in_pool(one_level, order, num_threads)
    else:
        _drain(map(one_level, order))


def _array(tensor: Tensor) -> Array:
    return tensor.contiguous().numpy()


def _over_points(kernel: Kernel, layout: GridLayout, arguments: Sequence[Any]) -> None:
    """Run `kernel(first, last, *arguments)` over the points, the first argument, in pieces of blocks."""
    num_points, num_threads = len(arguments[0]), torch.get_num_threads()
    pieces = min(num_threads, 1 + num_points * len(layout.levels) // PARALLEL_POINTS)
    if pieces <= 1:
        kernel(0, num_points, *arguments)
        return
    step = BLOCK * math.ceil(num_points / (BLOCK * pieces))
    starts = range(0, num_points, step)
    in_pool(lambda first: kernel(first, min(first + step, num_points), *arguments), starts, num_threads)


def over_rows(kernel: Kernel, num_rows: int, block: int, *arguments: Any) -> None:
    """Run `kernel(begin, end, *arguments)` for all rows, in as many pieces as torch has threads.

    A piece is made of blocks of `block` rows, at least two: below that a thread costs more than it saves.
    The results do not depend on the number of threads, for each block is what it would be without others.
    Named tuples are handed over as plain ones: numba's cache would not survive a change of their classes.
    """
    threads = torch.get_num_threads()
    pieces = min(threads, num_rows // (2 * block))
    arguments = _plain(arguments)
    if pieces <= 1:
        kernel(0, num_rows, *arguments)
        return
    step = block * math.ceil(num_rows / (pieces * block))
    starts = range(0, num_rows, step)
    in_pool(lambda begin: kernel(begin, min(begin + step, num_rows), *arguments), starts, threads)


def _plain(argument: Any) -> Any:
    return tuple(map(_plain, argument)) if isinstance(argument, tuple) else argument


def in_pool(function: Callable[[int], Any], values: Sequence[int], num_threads: int) -> None:
    """Call `function` with each of `values` in a pool of threads; raise what it raised."""
    _drain(_pool(num_threads).map(function, values))


def _drain(results: Any) -> None:
    """Wait for all results, raising what a task raised."""
    for _ in results:
        pass


@lru_cache
def _pool(num_threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(num_threads, thread_name_prefix="flashcache-encode")


@lru_cache
def levels_of(layout: GridLayout) -> Levels:
    """Return the layout as the arrays the kernels read."""
    counts, scales = level_constants(layout)
    return Levels(np.array(counts).astype(np.uint64), np.array(scales, np.float32))


_inlined = inlined()
# Without fused multiply-add, so that positions between voxels are the reference's, bit for bit. The option
# must be given: a function without it inherits its caller's.
_inlined_exact = inlined(fastmath=False)


ZERO, ONE = np.float32(0.0), np.float32(1.0)
STEP = np.uint64(1)


@_inlined_exact
def _axis(coordinate, scale, centre, largest):
    """Return the position u along one axis and whether it was inside (1.0) or clamped (0.0)."""
    u = coordinate * scale + centre
    # A NaN fails both comparisons and becomes 0.
    inside = ONE if ZERO <= u <= largest else ZERO
    u = u if u > ZERO else ZERO
    return (u if u < largest else largest), inside


@_inlined_exact
def _locate(z, i, counts, scales, level):
    """Return the 8 rows around point `i`, x fastest, its position between them, and the three `inside`."""
    scale, centre, largest = scales[level, 0], scales[level, 1], scales[level, 2]
    first, mask = counts[level, 0], counts[level, 1]
    multiplier_y, multiplier_z, top = counts[level, 2], counts[level, 3], counts[level, 4]
    x, inside_x = _axis(z[i, 0], scale, centre, largest)
    y, inside_y = _axis(z[i, 1], scale, centre, largest)
    w, inside_z = _axis(z[i, 2], scale, centre, largest)
    cell_x = min(np.uint64(np.uint32(x)), top)
    cell_y = min(np.uint64(np.uint32(y)), top)
    cell_z = min(np.uint64(np.uint32(w)), top)
    near = cell_x + cell_y * multiplier_y + cell_z * multiplier_z
    far = near + multiplier_z
    rows = (
        first + (near & mask),
        first + ((near + STEP) & mask),
        first + ((near + multiplier_y) & mask),
        first + ((near + multiplier_y + STEP) & mask),
        first + (far & mask),
        first + ((far + STEP) & mask),
        first + ((far + multiplier_y) & mask),
        first + ((far + multiplier_y + STEP) & mask),
    )
    position = (x - np.float32(cell_x), y - np.float32(cell_y), w - np.float32(cell_z))
    return rows, position, (inside_x * scale, inside_y * scale, inside_z * scale)


@_inlined
def _touch(table, counts, level, num_points):
    """Bring a level's rows into the cache; the sum is returned so that the compiler does not leave it out."""
    rows = counts[level, 5]
    total = ZERO
    values_per_line = np.uint64(16)
    values = rows * np.uint64(table.shape[1])
    # Each point reads about four lines of 16 values.
    if values <= np.uint64(TOUCHED_VALUES) and np.uint64(4 * num_points) * values_per_line >= values:
        stride = max(STEP, values_per_line // np.uint64(table.shape[1]))
        first = counts[level, 0]
        for row in range(first, first + rows, stride):
            total += table[row, 0]
    return total


@_inlined
def _mix(a, b, t):
    """Return a where t is 0 and b where t is 1."""
    return a + t * (b - a)


@lru_cache
def _kernels(num_features: int) -> Kernels:
    """Return the loops, compiled on first call, for this number of features."""
    F = num_features

    def forward(first, last, z, table, counts, scales, features):
        touched = ZERO
        for block in range(first, last, BLOCK):
            end = min(block + BLOCK, last)
            for level in range(counts.shape[0]):
                touched += _touch(table, counts, level, end - block)
                for i in range(block, end):
                    rows, (x, y, w), _ = _locate(z, i, counts, scales, level)
                    for f in range(F):
                        c0 = _mix(table[rows[0], f], table[rows[1], f], x)
                        c1 = _mix(table[rows[2], f], table[rows[3], f], x)
                        c2 = _mix(table[rows[4], f], table[rows[5], f], x)
                        c3 = _mix(table[rows[6], f], table[rows[7], f], x)
                        features[i, level * F + f] = _mix(_mix(c0, c1, y), _mix(c2, c3, y), w)
        return touched

    def forward_jacobian(first, last, z, table, counts, scales, features, jacobian):
        touched = ZERO
        for block in range(first, last, BLOCK):
            end = min(block + BLOCK, last)
            for level in range(counts.shape[0]):
                touched += _touch(table, counts, level, end - block)
                for i in range(block, end):
                    rows, (x, y, w), (rate_x, rate_y, rate_z) = _locate(z, i, counts, scales, level)
                    for f in range(F):
                        v0, v2, v4, v6 = (
                            table[rows[0], f],
                            table[rows[2], f],
                            table[rows[4], f],
                            table[rows[6], f],
                        )
                        d0, d1 = table[rows[1], f] - v0, table[rows[3], f] - v2
                        d2, d3 = table[rows[5], f] - v4, table[rows[7], f] - v6
                        c0, c1, c2, c3 = v0 + x * d0, v2 + x * d1, v4 + x * d2, v6 + x * d3
                        near, far = _mix(c0, c1, y), _mix(c2, c3, y)
                        column = level * F + f
                        features[i, column] = _mix(near, far, w)
                        jacobian[i, column, 0] = rate_x * _mix(_mix(d0, d1, y), _mix(d2, d3, y), w)
                        jacobian[i, column, 1] = rate_y * _mix(c1 - c0, c3 - c2, w)
                        jacobian[i, column, 2] = rate_z * (far - near)
        return touched

    def position_gradient(first, last, z, table, counts, scales, gradient, result):
        touched = ZERO
        for block in range(first, last, BLOCK):
            end = min(block + BLOCK, last)
            result[block:end] = ZERO
            for level in range(counts.shape[0]):
                touched += _touch(table, counts, level, end - block)
                for i in range(block, end):
                    rows, (x, y, w), (rate_x, rate_y, rate_z) = _locate(z, i, counts, scales, level)
                    sum_x, sum_y, sum_z = ZERO, ZERO, ZERO
                    for f in range(F):
                        v0, v2, v4, v6 = (
                            table[rows[0], f],
                            table[rows[2], f],
                            table[rows[4], f],
                            table[rows[6], f],
                        )
                        d0, d1 = table[rows[1], f] - v0, table[rows[3], f] - v2
                        d2, d3 = table[rows[5], f] - v4, table[rows[7], f] - v6
                        c0, c1, c2, c3 = v0 + x * d0, v2 + x * d1, v4 + x * d2, v6 + x * d3
                        g = gradient[i, level * F + f]
                        sum_x += g * _mix(_mix(d0, d1, y), _mix(d2, d3, y), w)
                        sum_y += g * _mix(c1 - c0, c3 - c2, w)
                        sum_z += g * (_mix(c2, c3, y) - _mix(c0, c1, y))
                    result[i, 0] += rate_x * sum_x
                    result[i, 1] += rate_y * sum_y
                    result[i, 2] += rate_z * sum_z
        return touched

    def table_gradient(level, z, counts, scales, gradient, result):
        touched = _touch(result, counts, level, len(z))
        for i in range(len(z)):
            rows, (x, y, w), _ = _locate(z, i, counts, scales, level)
            for f in range(F):
                g = gradient[i, level * F + f]
                far = g * w
                near = g - far
                far_y, near_y = far * y, near * y
                a0, a1, a2, a3 = near - near_y, near_y, far - far_y, far_y
                b0, b1, b2, b3 = a0 * x, a1 * x, a2 * x, a3 * x
                result[rows[0], f] += a0 - b0
                result[rows[1], f] += b0
                result[rows[2], f] += a1 - b1
                result[rows[3], f] += b1
                result[rows[4], f] += a2 - b2
                result[rows[5], f] += b2
                result[rows[6], f] += a3 - b3
                result[rows[7], f] += b3
        return touched

    def table_gradient_jacobian(level, z, counts, scales, gradient, jacobian_gradient, result):
        # `forward_jacobian` read backwards: each line gives the gradient of what that line read.
        touched = _touch(result, counts, level, len(z))
        for i in range(len(z)):
            rows, (x, y, w), (rate_x, rate_y, rate_z) = _locate(z, i, counts, scales, level)
            for f in range(F):
                column = level * F + f
                g = gradient[i, column]
                gx = jacobian_gradient[i, column, 0] * rate_x
                gy = jacobian_gradient[i, column, 1] * rate_y
                gz = jacobian_gradient[i, column, 2] * rate_z
                far = g * w + gz
                near = g - far
                dy_far = gy * w
                dy_near = gy - dy_far
                c3 = far * y + dy_far
                c2 = far - c3
                c1 = near * y + dy_near
                c0 = near - c1
                dx_far = gx * w
                dx_near = gx - dx_far
                d3 = dx_far * y
                d2 = dx_far - d3
                d1 = dx_near * y
                d0 = dx_near - d1
                b0, b1, b2, b3 = c0 * x + d0, c1 * x + d1, c2 * x + d2, c3 * x + d3
                result[rows[0], f] += c0 - b0
                result[rows[1], f] += b0
                result[rows[2], f] += c1 - b1
                result[rows[3], f] += b1
                result[rows[4], f] += c2 - b2
                result[rows[5], f] += b2
                result[rows[6], f] += c3 - b3
                result[rows[7], f] += b3
        return touched

    return Kernels(
        forward=compiled()(forward),
        forward_jacobian=compiled()(forward_jacobian),
        table_gradient=compiled()(table_gradient),
        table_gradient_jacobian=compiled()(table_gradient_jacobian),
        position_gradient=compiled()(position_gradient),
    )
