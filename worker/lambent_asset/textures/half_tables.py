"""Feature tables stored as float16: the resulting model, and its error relative to the trained one."""

import copy
from collections.abc import Mapping

import numpy as np
import torch
from flashcache.encoding.hash_grid import HashGrid
from flashcache.export.stored_grids import trained_grids
from flashcache.physical.model import InverseModel
from lambent_proto.v1 import bundle_pb2
from numpy.typing import NDArray

MOST_ROUNDING = 1e-2
"""Root mean square of an output's error up to which float16 tables are chosen, relative above 1."""
_OWN = ("opacity", "radiance")
"""Outputs whose error is not weighted; the others are weighted by opacity, below which they mean little."""


def with_half_tables(model: InverseModel) -> InverseModel:
    """Return a copy of `model` whose exported feature tables hold float16 numbers, as float32."""
    rounded = copy.deepcopy(model)
    with torch.no_grad():
        for grid in trained_grids(rounded):
            if isinstance(grid, HashGrid):
                grid.fold_scale()
            grid.table.copy_(grid.table.half().float())
    return rounded


def fits_half(model: InverseModel) -> bool:
    """Return whether every feature of the exported tables is inside float16's range."""
    limit = torch.finfo(torch.float16).max
    grids = trained_grids(model)
    return all(bool((grid.output_scale * grid.table.abs() <= limit).all()) for grid in grids)


def rounding_of(
    rounded: Mapping[str, NDArray[np.floating]], exact: Mapping[str, NDArray[np.floating]]
) -> list[bundle_pb2.Rounding]:
    """Return the error of each output [row, n] with rounded tables relative to exact ones, by name.

    Absolute below 1 and relative above. Errors of surface properties, normals and distances are multiplied by
    the exact answer's opacity.
    """
    weight = exact.get("opacity", np.ones((1, 1)))
    found = []
    for name, wanted in sorted(exact.items()):
        error = np.abs(rounded[name].astype(np.float64) - wanted) / np.maximum(1.0, np.abs(wanted))
        error = error if name in _OWN else error * weight
        rounding = bundle_pb2.Rounding(output=name, max_abs_error=error.max(), num_samples=len(error))
        rounding.rms_error = np.sqrt((error**2).mean())
        found.append(rounding)
    return found
