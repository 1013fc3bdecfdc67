"""The feature grids that a bundle stores, and the modules they come from."""

from dataclasses import dataclass, replace
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from flashcache.encoding.hash_grid import HashGrid
from flashcache.encoding.occupancy import Occupancy
from flashcache.kernels.layout import GridLayout
from flashcache.physical.model import InverseModel

OCCUPANCY = "nerf.occupancy"


@dataclass(frozen=True)
class StoredGrid:
    """A grid as graphs read it."""

    layout: GridLayout
    table: Float[Tensor, "rows features"]
    output_scale: float


def exported_grids(model: InverseModel) -> dict[str, StoredGrid]:
    """Return the grids that the graphs read, by the name of their table without ".table"."""
    return {name: _joined(parts) for name, parts in _parts(model).items()}


def trained_grids(model: InverseModel) -> list[HashGrid | Occupancy]:
    """Return the modules whose tables a bundle stores."""
    return [grid for parts in _parts(model).values() for grid in parts]


def _parts(model: InverseModel) -> dict[str, list[HashGrid | Occupancy]]:
    """Return the modules of each stored grid; what a model does not have is left out."""
    gloss = None if model.materials.gloss is None else model.materials.gloss.grid
    parts: dict[str, list[Any]] = {
        "nerf.density.grid": [model.nerf.density.grid],
        "materials.grid": [model.materials.grid, gloss],
        "fast.distance_grid": [model.fast.distance_grid],
        "fast.feature_grid": [model.fast.feature_grid],
        "nerf.normals.grid": [model.nerf.normals.grid],
        OCCUPANCY: [model.nerf.occupancy],
    }
    there = {name: [grid for grid in grids if grid is not None] for name, grids in parts.items()}
    return {name: grids for name, grids in there.items() if grids}


def _joined(grids: list[HashGrid | Occupancy]) -> StoredGrid:
    """Return the levels of all grids, which are alike but for their resolutions, as those of one grid."""
    first, levels, offset = grids[0], [], 0
    for grid in grids:
        levels += [replace(level, first_row=level.first_row + offset) for level in grid.layout.levels]
        offset += grid.layout.num_rows
    layout = replace(first.layout, levels=tuple(levels))
    table = first.table if len(grids) == 1 else torch.cat([grid.table for grid in grids])
    return StoredGrid(layout, table, first.output_scale)
