"""Priors on shape for short trainings: the distance of surfaces, and the variation of their normals.

Lengths are shares of half the diagonal of the scene's box, so that weights do not depend on its units.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from flashcache.errors import ConfigError
from flashcache.randomness import normal as draw_normal


@dataclass(frozen=True, kw_only=True, slots=True)
class ShapePriorConfig:
    """Priors on shape beyond the paper; all off by default (decision 0014)."""

    recession_weight: float = 0.0
    """Reward for distance during the carving phase."""
    flatness_weight: float = 0.0
    """Weight of the difference of neighbouring normals; rises with the normal loss."""
    flatness_step: float = 0.017
    """Standard deviation of the step between compared points."""
    flatness_rays: int = 512
    """Rays of a batch that take part in flatness, one point each."""
    emptiness_weight: float = 0.0
    """Weight of the mean opacity of the space that may hold something (decision 0021)."""
    emptiness_step: float = 0.03
    """Length over which it is an opacity."""
    emptiness_points: int = 256
    """Random points of a batch at which it is looked for."""

    def __post_init__(self) -> None:
        for name in ("flatness_rays", "emptiness_points"):
            if getattr(self, name) < 1:
                raise ConfigError(f"{name} must be at least 1, got {getattr(self, name)}")


def recession(
    weights: Float[Tensor, "rays samples"],
    distances: Float[Tensor, "rays samples"],
    coverage: Float[Tensor, " rays"],
) -> Float[Tensor, ""]:
    """Return minus the mean distance seen by fully covered pixels: the farther the surface, the lower.

    Where colours do not determine the distance of a surface, as on a mirror or in its reflection,
    photographs and outline agree with every surface between the visual hull and the true one; this term
    prefers the farthest.
    `distances` count from where the ray enters the scene and are constants: only render weights move.
    """
    mean = (weights * distances.detach()).sum(dim=-1) / weights.sum(dim=-1).clamp_min(0.05)
    return -torch.where(coverage > 0.99, mean, torch.zeros_like(mean)).mean()


def flatness(
    normal: Float[Tensor, "points 3"],
    nearby: Float[Tensor, "points 3"],
    weight: Float[Tensor, " points"],
) -> Float[Tensor, ""]:
    """Return the weighted mean distance of normals that lie close together.

    It is the distance, not its square, so that a crease costs no more than the same turn spread over a bump.
    """
    difference = torch.sqrt((normal - nearby).square().sum(dim=-1) + 1e-4)
    return (difference * weight).mean()


def tangent_steps(
    normal: Float[Tensor, "points 3"], scale: float, generator: torch.Generator
) -> Float[Tensor, "points 3"]:
    """Return random steps along the surface, normally distributed with standard deviation `scale`."""
    frozen = normal.detach()
    step = scale * draw_normal(normal.shape, generator, normal.device, normal.dtype)
    return step - (step * frozen).sum(dim=-1, keepdim=True) * frozen


def emptiness(density: Float[Tensor, " points"], length: float) -> Float[Tensor, ""]:
    """Return the mean opacity of stretches of `length` through points of `density` [1/scene unit].

    What no photograph shows would keep the density that it began with; this term makes it empty. Where
    photographs show something, their losses are far stronger.
    """
    return -torch.expm1(-density * length).mean()
