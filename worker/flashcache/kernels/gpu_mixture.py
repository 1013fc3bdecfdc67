"""Features of the samples along rays, contracted, weighted and summed, as Triton kernels.

    mixture[ray] = sum over samples of weight[ray, sample] * features(contract(points[ray, sample]))

without the features of single samples in memory. Notation, precision and types are those of `gpu_kernels`;
the contraction is that of `flashcache.geometry.contraction`.
"""

from typing import Any

import torch
import triton
import triton.language as tl
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

from flashcache.kernels import gpu
from flashcache.kernels.gpu_kernels import add_to_rows, block_of, interpolate, load_vector, locate, spread
from flashcache.kernels.layout import GridLayout

_VARYING = ("num_samples", "num_rays", "num_levels")


def encode(
    points: Float[Tensor, "rays samples 3"],
    weights: Float[Tensor, "rays samples"],
    table: Float[Tensor, "rows features"],
    layout: GridLayout,
    radius: float,
) -> Float[Tensor, "rays outputs"]:
    """Return the mixture of each ray; `points` and `radius`, which becomes 1, are in scene units."""
    mixture = points.new_empty(len(points), layout.num_outputs)
    arrays = points.contiguous(), weights.contiguous(), table.contiguous()
    arguments = *arrays, *gpu.levels(layout, points.device), mixture, 1.0 / radius, weights.shape[1]
    gpu.launch(forward, layout, len(points), len(layout.levels), *arguments)
    return mixture


def add_table_gradient(
    points: Float[Tensor, "rays samples 3"],
    weights: Float[Tensor, "rays samples"],
    layout: GridLayout,
    radius: float,
    mixture_gradient: Float[Tensor, "rays outputs"],
    gradient: Float[Tensor, "rows features"],
) -> None:
    """Add the gradient by the table to `gradient`, which is contiguous."""
    assert gradient.is_contiguous()
    arrays = points.contiguous(), weights.contiguous(), *gpu.levels(layout, points.device)
    arguments = *arrays, mixture_gradient.contiguous(), gradient, 1.0 / radius, weights.shape[1]
    gpu.launch(table_gradient, layout, len(points), len(layout.levels), *arguments)


def sample_gradients(
    points: Float[Tensor, "rays samples 3"],
    weights: Float[Tensor, "rays samples"],
    table: Float[Tensor, "rows features"],
    layout: GridLayout,
    radius: float,
    mixture_gradient: Float[Tensor, "rays outputs"],
) -> tuple[Float[Tensor, "rays samples 3"], Float[Tensor, "rays samples"]]:
    """Return the gradients by `points` and by `weights`."""
    arrays = points.contiguous(), weights.contiguous(), table.contiguous()
    constants = gpu.levels(layout, points.device)
    results = torch.empty_like(arrays[0]), torch.empty_like(arrays[1])
    arguments = *arrays, *constants, mixture_gradient.contiguous(), *results, 1.0 / radius, weights.shape[1]
    gpu.launch(sample_gradient, layout, len(points), weights.shape[1], *arguments)
    return results


def encode_mixture(
    points: Float[Tensor, "rays samples 3"],
    weights: Float[Tensor, "rays samples"],
    table: Float[Tensor, "rows features"],
    layout: GridLayout,
    radius: float,
    *,
    in_place_gradient: bool = False,
) -> Float[Tensor, "rays outputs"]:
    """Return the weighted sum of the features of the contracted `points` of each ray.

    `points` and `radius`, the radius that contraction maps to 1, are in scene units. Differentiable once, by
    `points`, `weights` and `table`; `in_place_gradient` as for `dispatch.encode`.
    """
    if torch.is_grad_enabled() and (points.requires_grad or weights.requires_grad or table.requires_grad):
        return _Mixture.apply(points, weights, table, layout, radius, in_place_gradient)
    return encode(points.detach(), weights.detach(), table.detach(), layout, radius)


class _Mixture(torch.autograd.Function):
    """The mixture with first-order gradients; features are looked up again in the backward pass."""

    @staticmethod
    def forward(
        ctx: Any,
        points: Tensor,
        weights: Tensor,
        table: Tensor,
        layout: GridLayout,
        radius: float,
        in_place_gradient: bool,
    ) -> Tensor:
        ctx.save_for_backward(points, weights, table)
        ctx.table, ctx.in_place_gradient, ctx.space = table, in_place_gradient, (layout, radius)
        return encode(points.detach(), weights.detach(), table.detach(), layout, radius)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> Any:
        points, weights, table = (saved.detach() for saved in ctx.saved_tensors)
        of_points = of_weights = of_table = None
        if ctx.needs_input_grad[0] or ctx.needs_input_grad[1]:
            of_points, of_weights = sample_gradients(points, weights, table, *ctx.space, gradient)
        if ctx.needs_input_grad[2]:
            in_place = ctx.in_place_gradient and ctx.table.grad is not None
            buffer = ctx.table.grad if in_place else torch.zeros_like(ctx.table)
            add_table_gradient(points, weights, *ctx.space, gradient, buffer)
            of_table = None if in_place else buffer
        return of_points, of_weights, of_table, None, None, None


@triton.jit
def _contract(point, inverse_radius):
    """Return contracted coordinates, and the scales of steps across and along the point's direction.

    The direction is that of the point times the square root of the latter; inside the ball all scales are 1.
    """
    x, y, w = point[0] * inverse_radius, point[1] * inverse_radius, point[2] * inverse_radius
    norm = tl.sqrt(x * x + y * y + w * w)
    inverse = tl.div_rn(1.0, tl.maximum(norm, 1.0))
    across = (2.0 - inverse) * inverse
    return (x * across, y * across, w * across), across, inverse * inverse


@triton.jit(do_not_specialize=_VARYING)
def forward(
    points, weights, table, counts, scales, mixture, inverse_radius, num_samples, num_rays, num_levels,
    F: tl.constexpr, WIDTH: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """Write the mixture [rays, levels, F]; a program takes all samples of its rays in one level."""
    level = tl.program_id(1)
    ray, exists = block_of(num_rays, BLOCK)
    feature = tl.arange(0, WIDTH)[None, :]
    total = tl.zeros((BLOCK, WIDTH), tl.float32)
    for sample in range(num_samples):
        place = ray * num_samples + sample
        coordinates, _, _ = _contract(load_vector(points, place, exists), inverse_radius)
        rows, position, _ = locate(coordinates, counts, scales, level)
        value, _ = interpolate(table, rows, position, feature, exists, F)
        total = tl.fma(tl.load(weights + place, exists, 0.0), value, total)
    tl.store(mixture + (ray * num_levels + level) * F + feature, total, exists & (feature < F))


@triton.jit(do_not_specialize=_VARYING)
def table_gradient(
    points, weights, counts, scales, by_mixture, result, inverse_radius, num_samples, num_rays, num_levels,
    F: tl.constexpr, WIDTH: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """Add the gradient by the table to `result` [rows, F]; the order of the additions is left open."""
    level = tl.program_id(1)
    ray, exists = block_of(num_rays, BLOCK)
    feature = tl.arange(0, WIDTH)[None, :]
    wanted = exists & (feature < F)
    g = tl.load(by_mixture + (ray * num_levels + level) * F + feature, wanted, 0.0)
    for sample in range(num_samples):
        place = ray * num_samples + sample
        coordinates, _, _ = _contract(load_vector(points, place, exists), inverse_radius)
        rows, position, _ = locate(coordinates, counts, scales, level)
        c, b = spread(tl.load(weights + place, exists, 0.0) * g, position)
        add_to_rows(result, rows, feature, c, b, wanted, F)


@triton.jit(do_not_specialize=_VARYING)
def sample_gradient(
    points, weights, table, counts, scales, by_mixture, by_points, by_weights, inverse_radius,
    num_samples, num_rays, num_levels,
    F: tl.constexpr, WIDTH: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """Write the gradients by points and weights; a program sums over all levels of one sample of its rays."""
    ray, exists = block_of(num_rays, BLOCK)
    place = ray * num_samples + tl.program_id(1)
    feature = tl.arange(0, WIDTH)[None, :]
    point = load_vector(points, place, exists)
    coordinates, across, along = _contract(point, inverse_radius)
    weighted = tl.zeros((BLOCK, WIDTH), tl.float32)
    sum_x = tl.zeros((BLOCK, WIDTH), tl.float32)
    sum_y = tl.zeros((BLOCK, WIDTH), tl.float32)
    sum_z = tl.zeros((BLOCK, WIDTH), tl.float32)
    for level in range(num_levels):
        rows, position, rates = locate(coordinates, counts, scales, level)
        value, slopes = interpolate(table, rows, position, feature, exists, F)
        g = tl.load(by_mixture + (ray * num_levels + level) * F + feature, exists & (feature < F), 0.0)
        weighted = tl.fma(value, g, weighted)
        sum_x = tl.fma(rates[0] * slopes[0], g, sum_x)
        sum_y = tl.fma(rates[1] * slopes[1], g, sum_y)
        sum_z = tl.fma(rates[2] * slopes[2], g, sum_z)
    tl.store(by_weights + place, tl.sum(weighted, 1, keep_dims=True), exists)
    factor = tl.load(weights + place, exists, 0.0) * inverse_radius
    gx = factor * tl.sum(sum_x, 1, keep_dims=True)
    gy = factor * tl.sum(sum_y, 1, keep_dims=True)
    gz = factor * tl.sum(sum_z, 1, keep_dims=True)
    # As `contract_vjp`: the Jacobian is symmetric, with the eigenvalues `across` and `along`.
    x, y, w = point[0] * inverse_radius, point[1] * inverse_radius, point[2] * inverse_radius
    rest = (along - across) * along * (gx * x + gy * y + gz * w)
    tl.store(by_points + place * 3, tl.fma(across, gx, rest * x), exists)
    tl.store(by_points + place * 3 + 1, tl.fma(across, gy, rest * y), exists)
    tl.store(by_points + place * 3 + 2, tl.fma(across, gz, rest * w), exists)
