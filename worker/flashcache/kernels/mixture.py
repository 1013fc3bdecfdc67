"""The fused mixture along rays with its gradients, for float32 on a GPU; the kernels are in `gpu_mixture`."""

from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

from flashcache.kernels import gpu_mixture
from flashcache.kernels.layout import GridLayout


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
    return gpu_mixture.encode(points.detach(), weights.detach(), table.detach(), layout, radius)


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
        return gpu_mixture.encode(points.detach(), weights.detach(), table.detach(), layout, radius)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> Any:
        points, weights, table = (saved.detach() for saved in ctx.saved_tensors)
        of_points = of_weights = of_table = None
        if ctx.needs_input_grad[0] or ctx.needs_input_grad[1]:
            of_points, of_weights = gpu_mixture.sample_gradients(points, weights, table, *ctx.space, gradient)
        if ctx.needs_input_grad[2]:
            in_place = ctx.in_place_gradient and ctx.table.grad is not None
            buffer = ctx.table.grad if in_place else torch.zeros_like(ctx.table)
            gpu_mixture.add_table_gradient(points, weights, *ctx.space, gradient, buffer)
            of_table = None if in_place else buffer
        return of_points, of_weights, of_table, None, None, None
