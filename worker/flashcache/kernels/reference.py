"""The encoder in plain torch: any dtype, any device, any order of derivative. The other backends equal it.

The formula is in `flashcache.kernels.layout`.
"""

from functools import lru_cache

import torch
from jaxtyping import Float, Int
from torch import Tensor

from flashcache.kernels.layout import GridLayout, level_constants


def encode(
    z: Float[Tensor, "points 3"], table: Float[Tensor, "rows features"], layout: GridLayout
) -> Float[Tensor, "points outputs"]:
    """Return the interpolated features of `z`, levels coarse to fine.

    `z` is clamped to the cube. Differentiable by `z` and `table`.
    """
    rows, fraction, _ = _voxels(z, layout)
    values = _gather(table, rows)
    weights = _along(fraction, 0) * _along(fraction, 1) * _along(fraction, 2)
    return (values * weights[..., None]).sum(dim=-2).flatten(start_dim=1)


def encode_with_jacobian(
    z: Float[Tensor, "points 3"], table: Float[Tensor, "rows features"], layout: GridLayout
) -> tuple[Float[Tensor, "points outputs"], Float[Tensor, "points outputs 3"]]:
    """Return the features of `z` and their derivative by `z`, both differentiable.

    The derivative is piecewise linear in each coordinate and jumps at voxel centres.
    """
    rows, fraction, rate = _voxels(z, layout)
    values = _gather(table, rows)
    x, y, w = (_along(fraction, axis) for axis in range(3))
    features = (values * (x * y * w)[..., None]).sum(dim=-2)
    dx, dy, dw = (_slope(axis, z) for axis in range(3))
    derivative = torch.stack([dx * y * w, x * dy * w, x * y * dw], dim=-1)
    jacobian = torch.einsum("plcf,plck,plk->plfk", values, derivative, rate)
    return features.flatten(start_dim=1), jacobian.flatten(start_dim=1, end_dim=2)


def _voxels(
    z: Float[Tensor, "points 3"], layout: GridLayout
) -> tuple[
    Int[Tensor, "points levels 8"], Float[Tensor, "points levels 3"], Float[Tensor, "points levels 3"]
]:
    """Return the rows of the 8 voxels around each point, the position between them and d position / d z."""
    numbers, (scale, centre, largest) = _level_tensors(layout, z.dtype, z.device)
    free = z[:, None, :] * scale + centre
    u = torch.clamp(free, min=torch.zeros_like(largest), max=largest)
    cell = torch.minimum(u.detach().floor(), largest - 1.0)
    corner = cell.long()[:, :, None, :] + _corners(z.device)
    first_row, num_rows, multiplier_y, multiplier_z = numbers
    mixed = corner[..., 0] + corner[..., 1] * multiplier_y + corner[..., 2] * multiplier_z
    inside = (free.detach() >= 0.0) & (free.detach() <= largest)
    return first_row + mixed % num_rows, u - cell, inside * scale


def _gather(
    table: Float[Tensor, "rows features"], rows: Int[Tensor, "points levels 8"]
) -> Float[Tensor, "points levels 8 features"]:
    """Return the rows' values; unlike `table[rows]`, whose gradient sorts the rows, this one's just adds."""
    return table.index_select(0, rows.reshape(-1)).reshape(*rows.shape, table.shape[1])


def _along(fraction: Float[Tensor, "points levels 3"], axis: int) -> Float[Tensor, "points levels 8"]:
    """Return the weight of each of the 8 voxels along one axis: 1 - f on the near side, f on the far side."""
    far = _corners(fraction.device)[:, axis].to(torch.bool)
    f = fraction[..., axis, None]
    return torch.where(far, f, 1.0 - f)


def _slope(axis: int, like: Tensor) -> Float[Tensor, "8"]:
    """Return the derivative of `_along` by f: -1 on the near side, +1 on the far side."""
    return _corners(like.device)[:, axis].to(like.dtype) * 2.0 - 1.0


@lru_cache
def _corners(device: torch.device) -> Int[Tensor, "8 3"]:
    """Return the offsets {0, 1}^3, x fastest."""
    offsets = [[corner & 1, corner >> 1 & 1, corner >> 2] for corner in range(8)]
    return torch.tensor(offsets, device=device)


@lru_cache
def _level_tensors(
    layout: GridLayout, dtype: torch.dtype, device: torch.device
) -> tuple[Int[Tensor, "4 levels 1"], Float[Tensor, "3 levels 1"]]:
    """Return (first row, rows, multipliers of y and z) and (d u / d z, u of the centre, largest u) per level.

    The latter are rounded to `dtype` once, as those of the other backends are.
    """
    rows = [(le.first_row, le.num_rows, le.multiplier_y, le.multiplier_z) for le in layout.levels]
    _, scales = level_constants(layout)
    return (
        torch.tensor(rows, device=device).T[:, :, None],
        torch.tensor(scales, dtype=dtype, device=device).T[:, :, None],
    )
