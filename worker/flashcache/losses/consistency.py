"""Consistency of the cache's heads with the physically based estimates (supplement 2.9)."""

from jaxtyping import Float
from torch import Tensor


def consistency(
    cache: Float[Tensor, "points 3"],
    physical: Float[Tensor, "points 3"],
    point_weight: Float[Tensor, " points"],
) -> Float[Tensor, ""]:
    """Return a loss that moves a cache head towards the mean of a noisy physical estimate.

    Both are linear radiance at the same points. `physical` is detached, and the denominator holds
    the cache alone: the noisy estimate there would pull the target down. Since the cache side has no
    noise, one estimate already has the unbiased gradient of `(cache - E[physical])^2 / scale`.
    Source: supplement 2.9.
    """
    frozen = cache.detach()
    residual = 2.0 * (frozen - physical.detach()) / (frozen + 0.01)
    return ((cache * residual).mean(dim=-1) * point_weight).mean()
