"""Decay of feature grids towards zero."""

from collections.abc import Iterable

import torch
from jaxtyping import Float
from torch import Tensor

from flashcache.encoding.hash_grid import HashGrid


def grid_decay(grids: Iterable[HashGrid]) -> Float[Tensor, ""]:
    """Return half the mean squared feature of every level of the grids, summed over levels and grids.

    The mean is taken level by level, so that a small coarse level decays as fast as a large hashed one.
    Source: Zip-NeRF's weight decay, in the strength of the authors' public code.
    """
    means = []
    for grid in grids:
        rows = [level.num_rows for level in grid.layout.levels]
        means += [part.square().mean() for part in grid.table.split(rows)]
    return 0.5 * torch.stack(means).sum()
