"""The GPU's encoder without a GPU: `python interpreted_grid.py OUT` writes what its kernels answer.

Triton's interpreter runs the kernels as Python on tensors of the processor. Triton reads TRITON_INTERPRET
when it is imported, so that this is a process of its own. OUT is a file of `torch.save`: case -> answers.
"""

import os
import sys
from pathlib import Path
from typing import Any

os.environ["TRITON_INTERPRET"] = "1"
sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
import torch
from flashcache.kernels import dispatch, gpu
from flashcache.kernels.layout import GridLayout
from support.grid_cases import INTERPRETED, case

GUARDS = 10_000


def guarded(table: torch.Tensor) -> torch.Tensor:
    """Return the table with rows before and after it that show in every result that reads them."""
    surrounded = torch.full((len(table) + 2 * GUARDS, table.shape[1]), torch.nan)
    surrounded[GUARDS:-GUARDS] = table
    return surrounded[GUARDS:-GUARDS]


def answers(layout: GridLayout, points: int) -> dict[str, torch.Tensor]:
    """Return what all kernels answer for the points of `case`; gradients are added to ones."""
    z, table, by_features, by_jacobian = (torch.from_numpy(array) for array in case(layout, points))
    table = guarded(table)
    features, jacobian = gpu.encode_with_jacobian(z, table, layout)
    of_features, of_both = torch.ones_like(table), torch.ones_like(table)
    gpu.add_table_gradient(z, layout, by_features, None, of_features)
    gpu.add_table_gradient(z, layout, by_features, by_jacobian, of_both)
    return {
        "features": features,
        "jacobian": jacobian,
        "features alone": gpu.encode(z, table, layout),
        "table": of_features,
        "table of both": of_both,
        "position": gpu.position_gradient(z, table, layout, by_features),
    }


def with_64_bits(layout: GridLayout, points: int) -> dict[str, torch.Tensor]:
    """Return what the kernels answer if offsets into the table are 64-bit numbers."""
    largest, gpu.LARGEST_INT32 = gpu.LARGEST_INT32, 0
    gpu.levels.cache_clear()
    found = answers(layout, points)
    assert gpu.levels(layout, torch.device("cpu"))[0].dtype == torch.int64
    gpu.LARGEST_INT32 = largest
    gpu.levels.cache_clear()
    return found


def not_a_number(layout: GridLayout) -> dict[str, torch.Tensor]:
    """Return the answers for a point without a position, and for the corner whose voxels it should read."""
    table = guarded(torch.from_numpy(case(layout, 10)[1]))
    found = {}
    for name, value in (("nan", np.nan), ("corner", -layout.half_extent)):
        z = torch.full((1, 3), value)
        gradient = torch.zeros_like(table)
        by_features = torch.ones(1, layout.num_outputs)
        gpu.add_table_gradient(z, layout, by_features, None, gradient)
        found |= {f"{name}: features": gpu.encode(z, table, layout), f"{name}: table": gradient}
        found |= {f"{name}: position": gpu.position_gradient(z, table, layout, by_features)}
    return found


def no_points(layout: GridLayout) -> dict[str, torch.Tensor]:
    """Return the answers for an empty batch; the gradient overwrites ones."""
    table = torch.from_numpy(case(layout, 10)[1])
    z, nothing = torch.empty(0, 3), torch.empty(0, layout.num_outputs)
    features, jacobian = gpu.encode_with_jacobian(z, table, layout)
    gradient = torch.ones_like(table)
    gpu.add_table_gradient(z, layout, nothing, None, gradient, overwrite=True)
    position = gpu.position_gradient(z, table, layout, nothing)
    return {"features": features, "jacobian": jacobian, "table": gradient, "position": position}


def differentiated(layout: GridLayout, *, in_place: bool) -> dict[str, torch.Tensor]:
    """Return the gradients that `dispatch` records on this backend, added to ones with `in_place`."""
    z, table, by_features, by_jacobian = (torch.from_numpy(array) for array in case(layout, 40))
    z.requires_grad_()
    table.requires_grad_()
    table.grad = buffer = torch.ones_like(table)
    features = dispatch.encode(z, table, layout, in_place_gradient=in_place)
    outputs = dispatch.encode_with_jacobian(z.detach(), table, layout, in_place_gradient=in_place)
    torch.autograd.backward((features, *outputs), [by_features, by_features, by_jacobian])
    assert table.grad is buffer
    return {"table": table.grad, "position": z.grad}


def main(out: str) -> None:
    """Write the answers of all cases."""
    torch.set_num_threads(1)
    found: dict[str, Any] = {name: answers(layout, 300) for name, layout in INTERPRETED.items()}
    layout = INTERPRETED["mixed, 2 features"]
    found["64 bits"] = with_64_bits(layout, 300)
    found["nan"] = not_a_number(layout)
    found["no points"] = no_points(layout)
    dispatch._backend = lambda device, dtype: gpu
    found["handed out"] = differentiated(layout, in_place=False)
    found["in place"] = differentiated(layout, in_place=True)
    torch.save(found, out)


if __name__ == "__main__":
    main(sys.argv[1])
