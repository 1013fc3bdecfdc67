"""The choice of the backend for an encoder call, and its automatic differentiation.

float32 on a processor goes to the compiled loops of `cpu`; float32 on a GPU to the kernels of `gpu`, where
Triton is installed; everything else to `reference`. On a processor, queries of the caches without gradients
are compiled as a whole (`answers_compiled`). The environment variable LAMBENT_KERNELS, read once at import,
chooses less: `encoder` leaves all but the encoder to torch, `reference` everything (tests, debugging).
"""

import importlib.util
import os
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from typing import Any, Protocol, runtime_checkable

import torch
from jaxtyping import Float, UInt8
from torch import Tensor
from torch.autograd.function import once_differentiable

from flashcache.errors import ConfigError
from flashcache.geometry.rays import Rays
from flashcache.kernels import reference
from flashcache.kernels.layout import GridLayout
from flashcache.rows import shapes_are_fixed

_CHOICE = os.environ.get("LAMBENT_KERNELS", "auto")
CHOICES = ("auto", "encoder", "reference")
if _CHOICE not in CHOICES:
    raise ConfigError(f'LAMBENT_KERNELS must be "auto", "encoder" or "reference", got "{_CHOICE}"')


@runtime_checkable
class Backend(Protocol):
    """What a compiled backend does with float32 tensors of one device; no gradients are recorded."""

    def encode(self, z: Tensor, table: Tensor, layout: GridLayout) -> Tensor:
        """Return the features of `z`."""
        ...

    def encode_with_jacobian(self, z: Tensor, table: Tensor, layout: GridLayout) -> tuple[Tensor, Tensor]:
        """Return the features of `z` and their derivative by `z`."""
        ...

    def position_gradient(
        self, z: Tensor, table: Tensor, layout: GridLayout, features_gradient: Tensor
    ) -> Tensor:
        """Return the gradient by `z`, given the one by the features."""
        ...

    def add_table_gradient(
        self,
        z: Tensor,
        layout: GridLayout,
        features_gradient: Tensor,
        jacobian_gradient: Tensor | None,
        gradient: Tensor,
        *,
        overwrite: bool = False,
    ) -> None:
        """Add the gradient by the table to `gradient`, or write it there."""
        ...


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

    Differentiable by `z` and `table`; once on a compiled backend, any number of times on the reference.
    With `in_place_gradient` a backward pass adds to `table.grad`, where there is one, instead of handing out
    a gradient as large as the table: only for `Tensor.backward` and a table that is a leaf.
    """
    z = z.to(table.dtype)
    backend = _backend(table.device, table.dtype)
    if backend is None:
        return reference.encode(z, table, layout)
    if torch.is_grad_enabled() and (z.requires_grad or table.requires_grad):
        return _Encode.apply(z.contiguous(), table, layout, in_place_gradient, backend)
    return backend.encode(z.detach(), table.detach(), layout)


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
    backend = _backend(table.device, table.dtype)
    differentiable = torch.is_grad_enabled()
    if backend is None or (differentiable and z.requires_grad):
        return reference.encode_with_jacobian(z, table, layout)
    if differentiable and table.requires_grad:
        return _EncodeWithJacobian.apply(z.contiguous(), table, layout, in_place_gradient, backend)
    return backend.encode_with_jacobian(z.detach(), table.detach(), layout)


def answers_compiled(*tensors: Tensor) -> bool:
    """Return whether a query without gradients of these inputs and parameters is for compiled code.

    So it is while no gradients are recorded, for float32 on a processor; not with fixed shapes, which
    exist to compute what a GPU does.
    """
    if _CHOICE != "auto" or torch.is_grad_enabled() or shapes_are_fixed():
        return False
    return all(tensor.device.type == "cpu" and tensor.dtype == torch.float32 for tensor in tensors)


def stretch(
    rays: Rays, cells: UInt8[Tensor, "x y z"], low: Float[Tensor, "3"], high: Float[Tensor, "3"], step: float
) -> tuple[Float[Tensor, " rays"], Float[Tensor, " rays"]]:
    """Return near and far of the stretch of each ray on which a lattice has occupied cells; see `march`."""
    if is_fused(rays.near.device, rays.near.dtype):
        from flashcache.kernels import gpu_march

        return gpu_march.stretch(rays, cells, low, high, step)
    if _CHOICE == "reference" or rays.near.device.type != "cpu" or rays.near.dtype != torch.float32:
        from flashcache.kernels import march

        return march.stretch(rays, cells, low, high, step)
    from flashcache.kernels.cells import write_stretches

    first, last = torch.empty_like(rays.near), torch.empty_like(rays.far)
    tensors = (rays.origins, rays.directions, rays.near, rays.far, cells, low, high)
    arrays = [each.detach().contiguous().numpy() for each in tensors]
    write_stretches(*arrays, step, first.numpy(), last.numpy())
    return first, last


def has_gpu_kernels() -> bool:
    """Return whether float32 on a GPU has kernels of its own here: whether Triton is installed."""
    return _CHOICE != "reference" and _has_triton()


def is_fused(device: torch.device, dtype: torch.dtype) -> bool:
    """Return whether tensors of this kind take the fused kernels: float32 on a GPU, with Triton."""
    return device.type == "cuda" and dtype == torch.float32 and has_gpu_kernels()


@lru_cache
def _has_triton() -> bool:
    return importlib.util.find_spec("triton") is not None


def _backend(device: torch.device, dtype: torch.dtype) -> Backend | None:
    """Return the compiled backend for a table, or None for the reference.

    Each is imported when it is first needed: numba takes a third of a second, and Triton is not everywhere.
    """
    if _CHOICE == "reference" or dtype != torch.float32:
        return None
    if device.type == "cpu":
        from flashcache.kernels import cpu

        return cpu
    if device.type == "cuda" and _has_triton():
        from flashcache.kernels import gpu

        return gpu
    return None


def _table_gradient(ctx: Any, z: Tensor, features_gradient: Tensor, jacobian_gradient: Tensor | None) -> Any:
    """Return the gradient of the table, or None once it has been added in place."""
    in_place = ctx.in_place_gradient and ctx.table.grad is not None
    gradient = (
        ctx.table.grad if in_place else torch.empty_like(ctx.table, memory_format=torch.contiguous_format)
    )
    ctx.backend.add_table_gradient(
        z, ctx.layout, features_gradient, jacobian_gradient, gradient, overwrite=not in_place
    )
    return None if in_place else gradient


class _Encode(torch.autograd.Function):
    """Features with first-order gradients by position and table."""

    @staticmethod
    def forward(
        ctx: Any, z: Tensor, table: Tensor, layout: GridLayout, in_place_gradient: bool, backend: Backend
    ) -> Tensor:
        ctx.save_for_backward(z, table)
        ctx.table, ctx.layout, ctx.in_place_gradient, ctx.backend = table, layout, in_place_gradient, backend
        return backend.encode(z.detach(), table.detach(), layout)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> Any:
        z, table = (saved.detach() for saved in ctx.saved_tensors)
        z_gradient = table_gradient = None
        if ctx.needs_input_grad[0]:
            z_gradient = ctx.backend.position_gradient(z, table, ctx.layout, gradient)
        if ctx.needs_input_grad[1]:
            table_gradient = _table_gradient(ctx, z, gradient, None)
        return z_gradient, table_gradient, None, None, None


class _EncodeWithJacobian(torch.autograd.Function):
    """Features and Jacobian with first-order gradients by the table."""

    @staticmethod
    def forward(
        ctx: Any, z: Tensor, table: Tensor, layout: GridLayout, in_place_gradient: bool, backend: Backend
    ) -> tuple[Tensor, Tensor]:
        ctx.save_for_backward(z)
        ctx.table, ctx.layout, ctx.in_place_gradient, ctx.backend = table, layout, in_place_gradient, backend
        return backend.encode_with_jacobian(z.detach(), table.detach(), layout)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, features_gradient: Tensor, jacobian_gradient: Tensor) -> Any:
        (z,) = ctx.saved_tensors
        gradient = _table_gradient(ctx, z.detach(), features_gradient, jacobian_gradient)
        return None, gradient, None, None, None
