"""Priors on plain values: grey environments, and small features of grids."""

from collections.abc import Iterable

import torch
from jaxtyping import Float
from torch import Tensor

from flashcache.encoding.hash_grid import HashGrid


def grey_prior(radiance: Float[Tensor, "rays 3"]) -> Float[Tensor, ""]:
    """Return the mean absolute deviation of radiance from its own grey (decision 0006)."""
    return (radiance - radiance.mean(dim=-1, keepdim=True)).abs().mean()


def tint_prior(radiance: Float[Tensor, "rays 3"]) -> Float[Tensor, ""]:
    """Return the mean squared logarithm of each channel's mean over the geometric mean of all three.

    Unlike `grey_prior` it allows a blue sky and a red sun, and wants their sum to be white (decision 0030).
    """
    level = radiance.mean(dim=0).clamp_min(1e-4).log()
    return (level - level.mean()).square().mean()


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
