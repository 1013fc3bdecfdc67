"""The fused kernels without a GPU: `python interpreted_fused.py OUT NAME` writes what they answer in cases.

As `interpreted_grid.py`: in Triton's interpreter, and so in a process of its own.
"""

import os
import sys
from pathlib import Path

os.environ["TRITON_INTERPRET"] = "1"
sys.path.insert(0, str(Path(__file__).parents[1]))

import torch
from flashcache.encoding.directional import IntegratedDirectionalEncoding
from flashcache.encoding.hash_grid import HashGrid
from flashcache.encoding.occupancy import Occupancy
from flashcache.geometry.rays import Rays
from flashcache.kernels import dispatch
from support import fused_cases


def in_place() -> dict[str, torch.Tensor]:
    """Return the gradient by a table that is added in place to ones."""
    grid = HashGrid(fused_cases.GRIDS["2 features"])
    grid.in_place_gradient = True
    grid.table.grad = buffer = torch.ones_like(grid.table)
    answers = fused_cases.mixture(grid)
    assert grid.table.grad is buffer
    return answers


def nothing() -> dict[str, torch.Tensor]:
    """Return what no rays, directions and stretches give."""
    grid, none = HashGrid(fused_cases.GRIDS["2 features"]), torch.empty(0, 3)
    encoding = IntegratedDirectionalEncoding(3)
    rays = Rays(none, none, none[:, 0], none[:, 0])
    with torch.no_grad():
        return {
            "mixture": grid.mixture(torch.empty(0, 5, 3), torch.empty(0, 5), 1.0),
            "encoded": encoding(none, none[:, :1]),
            "near": Occupancy((-1.0,) * 3, (1.0,) * 3, 4).narrowed(rays).near,
        }


def main(out: str, name: str) -> None:
    """Write the answers of the operation `name` in all of its cases."""
    torch.set_num_threads(1)
    dispatch.is_fused = lambda device, dtype: dtype == torch.float32
    found = fused_cases.answers(name, torch.device("cpu")) | {"nothing": nothing()}
    if name == "mixture":
        found |= {"in place": in_place(), "fast cache": fused_cases.fast_cache(torch.device("cpu"))}
    torch.save(found, out)


if __name__ == "__main__":
    main(*sys.argv[1:])
