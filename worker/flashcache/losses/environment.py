"""Priors on the environment."""

from jaxtyping import Float
from torch import Tensor


def grey_prior(radiance: Float[Tensor, "rays 3"]) -> Float[Tensor, ""]:
    """Return the mean absolute deviation of radiance from its own grey (decision 0006)."""
    return (radiance - radiance.mean(dim=-1, keepdim=True)).abs().mean()
