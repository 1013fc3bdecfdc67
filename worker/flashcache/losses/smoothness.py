"""Smoothness of the materials where the pictures do not change (supplement 2.10)."""

from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

from flashcache.physical.brdf import Materials

SmoothnessGuide = Literal["decreasing", "printed", "none"]
""""decreasing" smooths less where the pseudo-albedo changes, "printed" is the supplement's
Eq. 9, which smooths more there, "none" smooths everywhere alike."""


def pseudo_albedo(
    radiance: Float[Tensor, "points 3"], irradiance: Float[Tensor, "points 3"]
) -> Float[Tensor, "points 3"]:
    """Return radiance over irradiance/pi, both of the cache: the pseudo-albedo (supplement Eq. 10)."""
    return (radiance / irradiance.clamp_min(1e-3)).clamp(0.0, 1.0).detach()


def smoothness(
    here: Materials,
    nearby: Materials,
    guess_here: Float[Tensor, "points 3"],
    guess_nearby: Float[Tensor, "points 3"],
    point_weight: Float[Tensor, " points"],
    *,
    guided: SmoothnessGuide = "decreasing",
) -> Float[Tensor, ""]:
    """Return the relative change of the materials over a small step, weighed down where pictures change.

    `guided` says how the pseudo-albedos enter. Source: supplement Eq. 8.
    Differs from the paper: Eq. 9 as printed ("printed") smooths only where the picture changes; by default
    we use the decreasing form `2 sigmoid(-4 change) + 0.1` (docs/decisions/0003-smoothness-weight.md).
    """

    def relative(a: Tensor, b: Tensor) -> Tensor:
        largest = torch.maximum(a, b).detach().clamp_min(1e-6)
        return ((a - b).abs() / largest).mean(dim=-1)

    total = (
        relative(here.albedo, nearby.albedo)
        + relative(here.alpha, nearby.alpha)
        + relative(here.metalness, nearby.metalness)
    )
    return (total * guide_weight(guess_here, guess_nearby, guided) * point_weight).mean()


def guide_weight(
    guess_here: Float[Tensor, "points 3"], guess_nearby: Float[Tensor, "points 3"], guided: SmoothnessGuide
) -> Float[Tensor, " points"]:
    """Return the weight of the smoothness between two points, from their pseudo-albedos (Eq. 9)."""
    change = (guess_here - guess_nearby).abs()
    if guided == "none":
        return torch.ones_like(change[:, 0])
    if guided == "printed":
        return change.mean(dim=-1)
    relative = change / torch.maximum(guess_here, guess_nearby).clamp_min(1e-3)
    return 2.0 * torch.sigmoid(-4.0 * relative.sum(dim=-1)) + 0.1
