"""The feature grids that a bundle stores, and the modules they come from."""

from dataclasses import dataclass, replace

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


def trained_grids(model: InverseModel) -> list[HashGrid | Occupancy]:
    """Return the modules whose tables a bundle stores."""
    found = [
        model.nerf.density.grid,
        model.materials.grid,
        model.fast.distance_grid,
        model.fast.feature_grid,
    ]
    extra = [model.nerf.normals.grid, model.nerf.occupancy]
    if model.materials.gloss is not None:
        extra.append(model.materials.gloss.grid)
    return found + [grid for grid in extra if grid is not None]


def exported_grids(model: InverseModel) -> dict[str, StoredGrid]:
    """Return the grids that the graphs read, by the name of their table without ".table"."""
    materials = [model.materials.grid]
    if model.materials.gloss is not None:
        materials.append(model.materials.gloss.grid)
    grids = {
        "nerf.density.grid": _stored(model.nerf.density.grid),
        "materials.grid": _joined(materials),
        "fast.distance_grid": _stored(model.fast.distance_grid),
        "fast.feature_grid": _stored(model.fast.feature_grid),
    }
    if model.nerf.normals.grid is not None:
        grids["nerf.normals.grid"] = _stored(model.nerf.normals.grid)
    if model.nerf.occupancy is not None:
        grids[OCCUPANCY] = _stored(model.nerf.occupancy)
    return grids


def _stored(grid: HashGrid | Occupancy) -> StoredGrid:
    return StoredGrid(grid.layout, grid.table, grid.output_scale)


def _joined(grids: list[HashGrid]) -> StoredGrid:
    """Return the levels of all grids, which are alike but for their resolutions, as those of one grid."""
    first, levels, offset = grids[0], [], 0
    for grid in grids:
        levels += [replace(level, first_row=level.first_row + offset) for level in grid.layout.levels]
        offset += grid.layout.num_rows
    layout = replace(first.layout, levels=tuple(levels))
    return StoredGrid(layout, torch.cat([grid.table for grid in grids]), first.output_scale)
