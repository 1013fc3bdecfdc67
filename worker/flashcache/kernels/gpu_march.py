"""The stretch of a ray on which a lattice has occupied cells, as a Triton kernel; the rule is in `march`."""

import math

import torch
import triton
import triton.language as tl
from jaxtyping import Float, UInt8
from torch import Tensor

from flashcache.geometry.rays import Rays
from flashcache.kernels import gpu
from flashcache.kernels.gpu_kernels import block_of, load_vector

SIZES = {"BLOCK": 16, "STEPS": 32}
"""Rays of a program, and points of a ray that it looks up at once: four for each of its threads."""


def stretch(
    rays: Rays, cells: UInt8[Tensor, "x y z"], low: Float[Tensor, "3"], high: Float[Tensor, "3"], step: float
) -> tuple[Float[Tensor, " rays"], Float[Tensor, " rays"]]:
    """Return new near and far distances; `low` and `high` are the lattice's corners, all in scene units."""
    tensors = rays.origins, rays.directions, rays.near, rays.far, cells, low, high
    arrays = [each.detach().contiguous() for each in tensors]
    first, last = torch.empty_like(arrays[2]), torch.empty_like(arrays[3])
    grid = (math.ceil(len(first) / SIZES["BLOCK"]),)
    gpu.start(write_stretches, grid, *arrays, first, last, step, cells.shape[0], len(first), **SIZES)
    return first, last


@triton.jit
def _place(origin, direction, t, low, high, count):
    """Return the positions of points along one axis in units of cells."""
    return (origin + t * direction - low) * tl.div_rn(count, high - low)


@triton.jit(do_not_specialize=("num_cells", "num_rays"))
def write_stretches(
    origins, directions, near, far, cells, low, high, first, last, step, num_cells, num_rays,
    BLOCK: tl.constexpr, STEPS: tl.constexpr,
):  # fmt: skip
    """Write where the stretches begin and end; `num_cells` counts cells along a side."""
    ray, exists = block_of(num_rays, BLOCK)
    origin, direction = load_vector(origins, ray, exists), load_vector(directions, ray, exists)
    start, end = tl.load(near + ray, exists, 0.0), tl.load(far + ray, exists, 0.0)
    count = num_cells.to(tl.float32)
    begin = tl.full((BLOCK, STEPS), float("inf"), tl.float32)
    finish = tl.full((BLOCK, STEPS), float("-inf"), tl.float32)
    longest = tl.max(tl.max(end - start, 1), 0)
    for k in range(0, tl.ceil(longest / step).to(tl.int32), STEPS):
        t = start + ((k + tl.arange(0, STEPS)[None, :]).to(tl.float32) + 0.5) * step
        x = _place(origin[0], direction[0], t, tl.load(low), tl.load(high), count)
        y = _place(origin[1], direction[1], t, tl.load(low + 1), tl.load(high + 1), count)
        z = _place(origin[2], direction[2], t, tl.load(low + 2), tl.load(high + 2), count)
        inside = (x >= 0.0) & (x < count) & (y >= 0.0) & (y < count) & (z >= 0.0) & (z < count)
        inside = inside & (t < end)
        cell = (x.to(tl.int32) * num_cells + y.to(tl.int32)) * num_cells + z.to(tl.int32)
        hit = tl.load(cells + cell, inside, 0) > 0
        begin = tl.minimum(begin, tl.where(hit, t, float("inf")))
        finish = tl.maximum(finish, tl.where(hit, t, float("-inf")))
    begin = tl.min(begin, 1, keep_dims=True)
    finish = tl.max(finish, 1, keep_dims=True)
    met = begin <= finish
    tl.store(first + ray, tl.where(met, tl.maximum(start, begin - step), start), exists)
    tl.store(last + ray, tl.where(met, tl.minimum(end, finish + step), start), exists)
