"""The choice of the backend for an encoder call, and its automatic differentiation.

float32 on a processor goes to the compiled loops of `cpu`, everything else to `reference`. The environment
variable LAMBENT_KERNELS=reference, read once at import, sends everything to the reference (tests, debugging).
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import torch
from jaxtyping import Float, UInt8
from torch import Tensor
from torch.autograd.function import once_differentiable

from flashcache.errors import ConfigError
from flashcache.geometry.rays import Rays
from flashcache.kernels import reference
from flashcache.kernels.layout import GridLayout

_CHOICE = os.environ.get("LAMBENT_KERNELS", "auto")
if _CHOICE not in ("auto", "reference"):
    raise ConfigError(f'LAMBENT_KERNELS must be "auto" or "reference", got "{_CHOICE}"')


@contextmanager
def using(choice: str) -> Iterator[None]:
    """Dispatch all calls as LAMBENT_KERNELS=`choice` would, for comparisons in one process."""
    global _CHOICE
    before, _CHOICE = _CHOICE, choice
    try:
        yield
    finally:
        _CHOICE = before


def encode(
    z: Float[Tensor, "points 3"],
    table: Float[Tensor, "rows features"],
    layout: GridLayout,
    *,
    in_place_gradient: bool = False,
) -> Float[Tensor, "points outputs"]:
    """Return the interpolated features of `z`, levels coarse to fine.

    Differentiable by `z` and `table`; once on the compiled backend, any number of times on the reference.
    With `in_place_gradient` a backward pass adds to `table.grad`, where there is one, instead of handing out
    a gradient as large as the table: only for `Tensor.backward` and a table that is a leaf.
    """
    z = z.to(table.dtype)
    if not _is_compiled(table):
        return reference.encode(z, table, layout)
    if torch.is_grad_enabled() and (z.requires_grad or table.requires_grad):
        return _Encode.apply(z.contiguous(), table, layout, in_place_gradient)
    return _encode(z, table, layout)


def encode_with_jacobian(
    z: Float[Tensor, "points 3"],
    table: Float[Tensor, "rows features"],
    layout: GridLayout,
    *,
    in_place_gradient: bool = False,
) -> tuple[Float[Tensor, "points outputs"], Float[Tensor, "points outputs 3"]]:
    """Return the features of `z` and their derivative by `z`, both differentiable by `table`.

    A `z` that requires a gradient uses the reference, the only backend with a second derivative by `z`.
    """
    z = z.to(table.dtype)
    differentiable = torch.is_grad_enabled()
    if not _is_compiled(table) or (differentiable and z.requires_grad):
        return reference.encode_with_jacobian(z, table, layout)
    if differentiable and table.requires_grad:
        return _EncodeWithJacobian.apply(z.contiguous(), table, layout, in_place_gradient)
    return _encode_with_jacobian(z, table, layout)


def stretch(
    rays: Rays, cells: UInt8[Tensor, "x y z"], low: Float[Tensor, "3"], high: Float[Tensor, "3"], step: float
) -> tuple[Float[Tensor, " rays"], Float[Tensor, " rays"]]:
    """Return near and far of the stretch of each ray on which a lattice has occupied cells; see `march`."""
    if not _is_compiled(rays.near):
        from flashcache.kernels import march

        return march.stretch(rays, cells, low, high, step)
    from flashcache.kernels.cells import write_stretches

    first, last = torch.empty_like(rays.near), torch.empty_like(rays.far)
    tensors = (rays.origins, rays.directions, rays.near, rays.far, cells, low, high)
    arrays = [each.detach().contiguous().numpy() for each in tensors]
    write_stretches(*arrays, step, first.numpy(), last.numpy())
    return first, last


def _is_compiled(table: Tensor) -> bool:
    return _CHOICE == "auto" and table.device.type == "cpu" and table.dtype == torch.float32


def _encode(z: Tensor, table: Tensor, layout: GridLayout) -> Tensor:
    from flashcache.kernels import cpu  # numba takes a third of a second to import

    arrays = z.detach().contiguous().numpy(), table.detach().numpy()
    return torch.from_numpy(cpu.encode(*arrays, layout, torch.get_num_threads()))


def _encode_with_jacobian(z: Tensor, table: Tensor, layout: GridLayout) -> tuple[Tensor, Tensor]:
    from flashcache.kernels import cpu

    arrays = z.detach().contiguous().numpy(), table.detach().numpy()
    features, jacobian = cpu.encode_with_jacobian(*arrays, layout, torch.get_num_threads())
    return torch.from_numpy(features), torch.from_numpy(jacobian)


def _table_gradient(ctx: Any, z: Tensor, features_gradient: Tensor, jacobian_gradient: Tensor | None) -> Any:
    """Return the gradient of the table, or None once it has been added in place."""
    from flashcache.kernels import cpu

    in_place = ctx.in_place_gradient and ctx.table.grad is not None
    gradient = ctx.table.grad if in_place else torch.empty_like(ctx.table)
    cpu.add_table_gradient(
        z.numpy(),
        ctx.layout,
        features_gradient.contiguous().numpy(),
        None if jacobian_gradient is None else jacobian_gradient.contiguous().numpy(),
        gradient.numpy(),
        torch.get_num_threads(),
        overwrite=not in_place,
    )
    return None if in_place else gradient


class _Encode(torch.autograd.Function):
    """Features with first-order gradients by position and table."""

    @staticmethod
    def forward(ctx: Any, z: Tensor, table: Tensor, layout: GridLayout, in_place_gradient: bool) -> Tensor:
        ctx.save_for_backward(z, table)
        ctx.table, ctx.layout, ctx.in_place_gradient = table, layout, in_place_gradient
        return _encode(z, table, layout)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> Any:
        from flashcache.kernels import cpu

        z, table = ctx.saved_tensors
        z_gradient = table_gradient = None
        if ctx.needs_input_grad[0]:
            arrays = z.detach().numpy(), table.detach().numpy(), ctx.layout, gradient.contiguous().numpy()
            z_gradient = torch.from_numpy(cpu.position_gradient(*arrays, torch.get_num_threads()))
        if ctx.needs_input_grad[1]:
            table_gradient = _table_gradient(ctx, z.detach(), gradient, None)
        return z_gradient, table_gradient, None, None


class _EncodeWithJacobian(torch.autograd.Function):
    """Features and Jacobian with first-order gradients by the table."""

    @staticmethod
    def forward(
        ctx: Any, z: Tensor, table: Tensor, layout: GridLayout, in_place_gradient: bool
    ) -> tuple[Tensor, Tensor]:
        ctx.save_for_backward(z)
        ctx.table, ctx.layout, ctx.in_place_gradient = table, layout, in_place_gradient
        return _encode_with_jacobian(z, table, layout)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, features_gradient: Tensor, jacobian_gradient: Tensor) -> Any:
        (z,) = ctx.saved_tensors
        return None, _table_gradient(ctx, z.detach(), features_gradient, jacobian_gradient), None, None
