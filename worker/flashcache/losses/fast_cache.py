"""Supervision of the fast cache by the NeRF cache on the correction term's rays."""

from jaxtyping import Float
from torch import Tensor

from flashcache.caches.nerf_cache import SECONDARY_CURVE
from flashcache.color import loss_curve
from flashcache.physical.incident import Incident, RayLimits


def fast_cache_loss(
    answer: Incident,
    target: Incident,
    inside: Float[Tensor, " rays"],
    limits: RayLimits,
    *,
    opacity_weight: float = 0.125,
    distance_weight: float = 0.1,
) -> Float[Tensor, ""]:
    """Return the distance of the fast cache's answer from the NeRF cache's, which is detached.

    Radiance is compared in sRGB, opacity linearly, distance in normalised distance where the ray is
    mostly blocked. `inside` is one for rays that count. Source: supplement 2.1; the distance
    term is ours (docs/decisions/0004-distance-output.md).
    """
    rgb = (loss_curve(answer.near_radiance) - loss_curve(target.near_radiance.detach())).square().mean(dim=-1)
    opacity = (answer.opacity - target.opacity.detach()).square()
    start, end = answer.distance.new_tensor(limits.near), answer.distance.new_tensor(limits.far)
    wanted = SECONDARY_CURVE.normalised(target.distance.detach(), start, end)
    found = SECONDARY_CURVE.normalised(answer.distance, start, end)
    blocked = (target.opacity.detach() > 0.5).to(rgb.dtype)
    distance = blocked * (wanted - found).abs()
    return (inside * (rgb + opacity_weight * opacity + distance_weight * distance)).mean()
