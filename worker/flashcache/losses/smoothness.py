"""Smoothness of the materials where the pictures give no reason for a change (supplement 2.10)."""

import torch
from jaxtyping import Float
from torch import Tensor

from flashcache.physical.brdf import Materials


def pseudo_albedo(
    radiance: Float[Tensor, "points 3"], irradiance: Float[Tensor, "points 3"]
) -> Float[Tensor, "points 3"]:
    """Return diffuse radiance over irradiance/pi, the cache's guess at the albedo (supplement Eq. 10)."""
    return (radiance / irradiance.clamp_min(1e-3)).clamp(0.0, 1.0).detach()


def smoothness(
    here: Materials,
    nearby: Materials,
    guess_here: Float[Tensor, "points 3"],
    guess_nearby: Float[Tensor, "points 3"],
    point_weight: Float[Tensor, " points"],
) -> Float[Tensor, ""]:
    """Return the relative change of the materials over a small step, weighed down where pictures change.

    Differs from the paper: Eq. 9 as printed smooths only where the picture changes; we use the
    decreasing form `2 sigmoid(-4 change) + 0.1` (docs/decisions/0003-smoothness-weight.md).
    """

    def relative(a: Tensor, b: Tensor) -> Tensor:
        largest = torch.maximum(a, b).detach().clamp_min(1e-6)
        return ((a - b).abs() / largest).mean(dim=-1)

    total = (
        relative(here.albedo, nearby.albedo)
        + relative(here.alpha, nearby.alpha)
        + relative(here.metalness, nearby.metalness)
    )
    difference = (guess_here - guess_nearby).abs() / torch.maximum(guess_here, guess_nearby).clamp_min(1e-3)
    weight = 2.0 * torch.sigmoid(-4.0 * difference.sum(dim=-1)) + 0.1
    return (total * weight * point_weight).mean()
