"""Priors on the environment."""

from jaxtyping import Float
from torch import Tensor


def grey_prior(radiance: Float[Tensor, "rays 3"]) -> Float[Tensor, ""]:
    """Return the mean absolute deviation of radiance from its own grey (decision 0006)."""
    return (radiance - radiance.mean(dim=-1, keepdim=True)).abs().mean()


def tint_prior(radiance: Float[Tensor, "rays 3"]) -> Float[Tensor, ""]:
    """Return the mean squared logarithm of each channel's mean over the geometric mean of all three.

    Unlike `grey_prior` it allows a blue sky and a red sun, and wants their sum to be white (decision 0030).
    """
    level = radiance.mean(dim=0).clamp_min(1e-4).log()
    return (level - level.mean()).square().mean()
