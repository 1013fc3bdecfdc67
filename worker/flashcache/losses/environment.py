"""Priors on the light from far away.

Pictures are latitude-longitude in the convention of `geometry.directions`, linear Rec. 709.
"""

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from flashcache.errors import ConfigError


@dataclass(frozen=True, kw_only=True, slots=True)
class EnvironmentPriorConfig:
    """Priors on the environment beyond the paper; all off by default."""

    white_weight: float = 0.0
    """Weight of the deviation of the environment's total light from grey."""
    variation_weight: float = 0.0
    """Weight of the environment's relative total variation."""
    pole_aware: bool = True
    """Let a pixel count by its solid angle and neighbours by their distance on the sphere."""
    rows: int = 16
    """Rows of the picture on which the priors look, twice as many columns."""

    def __post_init__(self) -> None:
        if self.rows < 2:
            raise ConfigError(f"stage_two.environment_prior.rows must be at least 2, got {self.rows}")


def grey_prior(radiance: Float[Tensor, "rays 3"]) -> Float[Tensor, ""]:
    """Return the mean absolute deviation of radiance from its own grey (decision 0006)."""
    return (radiance - radiance.mean(dim=-1, keepdim=True)).abs().mean()


def row_weights(rows: int, *, pole_aware: bool, like: Tensor) -> Float[Tensor, "rows 1"]:
    """Return how much a pixel of each row counts, one on average: its solid angle, or the same for all."""
    if not pole_aware:
        return torch.ones(rows, 1, dtype=like.dtype, device=like.device)
    edges = torch.cos(torch.arange(rows + 1, dtype=like.dtype, device=like.device) * (math.pi / rows))
    return (0.5 * rows * (edges[:-1] - edges[1:]))[:, None]


def white_prior(image: Float[Tensor, "height width 3"], *, pole_aware: bool) -> Float[Tensor, ""]:
    """Return the relative deviation of the total light from grey, summed over the channels.

    Single directions may have any colour, unlike in `grey_prior`. Does not change when the light is scaled.
    """
    weight = row_weights(image.shape[0], pole_aware=pole_aware, like=image)[..., None]
    mean = (image * weight).mean(dim=(0, 1))
    grey = mean.mean().clamp_min(1e-6)
    return (mean - grey).abs().sum() / grey


def variation_prior(image: Float[Tensor, "height width 3"], *, pole_aware: bool) -> Float[Tensor, ""]:
    """Return the mean absolute slope of the light over the sphere, relative to its mean, in 1/rad.

    Without `pole_aware` the slope is per pixel of 2 pi / width, as if the picture were flat: the rows at the
    poles then cost as much as the equator.
    """
    height, width, _ = image.shape
    rows = row_weights(height, pole_aware=pole_aware, like=image)[..., None]
    step = math.pi / height
    polar = (torch.arange(height, dtype=image.dtype, device=image.device) + 0.5) * step
    ring = polar.sin()[:, None, None] if pole_aware else torch.ones_like(rows)
    around = (image.roll(-1, dims=1) - image).abs() / (2.0 * math.pi / width * ring)
    along = (image[1:] - image[:-1]).abs() / step
    between = 0.5 * (rows[1:] + rows[:-1])
    mean = (image * rows).mean().detach().clamp_min(1e-6)
    return ((around * rows).mean() + (along * between).mean()) / mean
