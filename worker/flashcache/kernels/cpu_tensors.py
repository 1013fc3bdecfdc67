"""The compiled loops of `cpu` for torch tensors: the backend of float32 on the processor.

As many threads as torch uses. The loops share memory with the tensors.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from flashcache.kernels import cpu
from flashcache.kernels.layout import GridLayout


def encode(
    z: Float[Tensor, "points 3"], table: Float[Tensor, "rows features"], layout: GridLayout
) -> Float[Tensor, "points outputs"]:
    """Return the features of `z`."""
    arrays = z.contiguous().numpy(), table.numpy()
    return torch.from_numpy(cpu.encode(*arrays, layout, torch.get_num_threads()))


def encode_with_jacobian(
    z: Float[Tensor, "points 3"], table: Float[Tensor, "rows features"], layout: GridLayout
) -> tuple[Float[Tensor, "points outputs"], Float[Tensor, "points outputs 3"]]:
    """Return the features of `z` and their derivative by `z`."""
    arrays = z.contiguous().numpy(), table.numpy()
    features, jacobian = cpu.encode_with_jacobian(*arrays, layout, torch.get_num_threads())
    return torch.from_numpy(features), torch.from_numpy(jacobian)


def position_gradient(
    z: Float[Tensor, "points 3"],
    table: Float[Tensor, "rows features"],
    layout: GridLayout,
    features_gradient: Float[Tensor, "points outputs"],
) -> Float[Tensor, "points 3"]:
    """Return the gradient by `z`, given the one by the features."""
    arrays = z.contiguous().numpy(), table.numpy(), layout, features_gradient.contiguous().numpy()
    return torch.from_numpy(cpu.position_gradient(*arrays, torch.get_num_threads()))


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
    cpu.add_table_gradient(
        z.contiguous().numpy(),
        layout,
        features_gradient.contiguous().numpy(),
        None if jacobian_gradient is None else jacobian_gradient.contiguous().numpy(),
        gradient.numpy(),
        torch.get_num_threads(),
        overwrite=overwrite,
    )
