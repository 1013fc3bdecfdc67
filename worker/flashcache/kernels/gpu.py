"""The kernels of `gpu_kernels` for torch tensors: the backend of float32 on an NVIDIA GPU.

The additions to a gradient by the table come in any order, so its last digits differ from run to run.
Everything else is the same in every run.
"""

import math
from functools import lru_cache
from typing import Any

import torch
from jaxtyping import Float, Int
from torch import Tensor

from flashcache.kernels import gpu_kernels
from flashcache.kernels.layout import GridLayout, level_constants

NUM_WARPS = 4
MAX_POINTS, MAX_VALUES = 128, 512
"""Of a program: at most one point, and four values of a row (one vector), for each of its threads."""

# Without fusion, positions between voxels are the reference's, bit for bit.
OPTIONS = {"num_warps": NUM_WARPS, "enable_fp_fusion": False}

LARGEST_INT32 = 2**31 - 1


def encode(
    z: Float[Tensor, "points 3"], table: Float[Tensor, "rows features"], layout: GridLayout
) -> Float[Tensor, "points outputs"]:
    """Return the features of `z`."""
    features = z.new_empty(len(z), layout.num_outputs)
    arrays = z.contiguous(), table.contiguous(), *levels(layout, z.device), features, features
    launch(gpu_kernels.forward, layout, len(z), len(layout.levels), *arrays, JACOBIAN=False)
    return features


def encode_with_jacobian(
    z: Float[Tensor, "points 3"], table: Float[Tensor, "rows features"], layout: GridLayout
) -> tuple[Float[Tensor, "points outputs"], Float[Tensor, "points outputs 3"]]:
    """Return the features of `z` and their derivative by `z`."""
    features = z.new_empty(len(z), layout.num_outputs)
    jacobian = z.new_empty(len(z), layout.num_outputs, 3)
    arrays = z.contiguous(), table.contiguous(), *levels(layout, z.device), features, jacobian
    launch(gpu_kernels.forward, layout, len(z), len(layout.levels), *arrays, JACOBIAN=True)
    return features, jacobian


def position_gradient(
    z: Float[Tensor, "points 3"],
    table: Float[Tensor, "rows features"],
    layout: GridLayout,
    features_gradient: Float[Tensor, "points outputs"],
) -> Float[Tensor, "points 3"]:
    """Return the gradient by `z`, given the one by the features."""
    gradient = z.new_empty(len(z), 3)
    constants = levels(layout, z.device)
    arrays = z.contiguous(), table.contiguous(), *constants, features_gradient.contiguous(), gradient
    # One program takes all levels of its points: their sum needs no additions in any order.
    launch(gpu_kernels.position_gradient, layout, len(z), 1, *arrays)
    return gradient


def add_table_gradient(
    z: Float[Tensor, "points 3"],
    layout: GridLayout,
    features_gradient: Float[Tensor, "points outputs"],
    jacobian_gradient: Float[Tensor, "points outputs 3"] | None,
    gradient: Float[Tensor, "rows features"],
    *,
    overwrite: bool = False,
) -> None:
    """Add the gradient by the table to `gradient`, which is contiguous, or write it there.

    `jacobian_gradient` is None where only features were used.
    """
    assert gradient.is_contiguous()
    if overwrite:
        gradient.zero_()
    by_features = features_gradient.contiguous()
    by_jacobian = by_features if jacobian_gradient is None else jacobian_gradient.contiguous()
    arrays = z.contiguous(), *levels(layout, z.device), by_features, by_jacobian, gradient
    uses_jacobian = jacobian_gradient is not None
    kernel, columns = gpu_kernels.table_gradient, len(layout.levels)
    launch(kernel, layout, len(z), columns, *arrays, JACOBIAN=uses_jacobian)


def block_sizes(num_features: int) -> dict[str, int]:
    """Return the sizes that are constants of a kernel for this number of features."""
    width = 1 << (num_features - 1).bit_length()
    return {"F": num_features, "WIDTH": width, "BLOCK": min(MAX_POINTS, MAX_VALUES // width)}


def launch(
    kernel: Any, layout: GridLayout, num_points: int, num_columns: int, *arguments: Any, **constants: bool
) -> None:
    """Start `num_columns` programs of a kernel per block of points.

    The kernel gets `arguments`, then the numbers of points and levels.
    """
    sizes = block_sizes(layout.num_features)
    grid = math.ceil(num_points / sizes["BLOCK"]), num_columns
    start(kernel, grid, *arguments, num_points, len(layout.levels), **sizes, **constants)


def start(kernel: Any, grid: tuple[int, ...], *arguments: Any, **constants: int) -> None:
    """Start a kernel on the device of the first argument, a tensor; nothing where the grid is empty."""
    if grid[0] == 0:
        return
    if arguments[0].is_cuda:
        gpu_kernels.require_launcher()
    # Triton starts kernels on the current device, which need not be that of the tensors.
    with torch.cuda.device_of(arguments[0]):
        kernel[grid](*arguments, **constants, **OPTIONS)


@lru_cache
def levels(
    layout: GridLayout, device: torch.device
) -> tuple[Int[Tensor, "levels 6"], Float[Tensor, "levels 3"]]:
    """Return the layout as the tensors the kernels read."""
    counts, scales = level_constants(layout)
    largest = layout.num_rows * layout.num_features
    integers = torch.int32 if largest <= LARGEST_INT32 else torch.int64
    return (
        torch.tensor(counts, dtype=integers, device=device),
        torch.tensor(scales, dtype=torch.float32, device=device),
    )
