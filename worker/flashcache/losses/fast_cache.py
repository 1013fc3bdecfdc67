"""Supervision of the fast cache by the NeRF cache on the correction term's rays."""

from jaxtyping import Bool, Float
from torch import Tensor

from flashcache.caches.nerf_cache import SECONDARY_CURVE
from flashcache.color import loss_curve
from flashcache.physical.incident import NearField, RayLimits
from flashcache.rows import mean_where


def fast_cache_loss(
    answer: NearField,
    target: NearField,
    inside: Float[Tensor, " rays"],
    limits: RayLimits,
    *,
    counted: Bool[Tensor, " rays"] | None = None,
    from_diffuse: Bool[Tensor, " rays"] | None = None,
    opacity_weight: float = 0.125,
    distance_weight: float = 0.1,
) -> Float[Tensor, ""]:
    """Return the distance of the fast cache's answer from the NeRF cache's, which is detached.

    Radiance is compared in sRGB, opacity linearly, distance in normalised distance where the ray is
    mostly blocked. `inside` is one for rays that start where the cache is taught. Rays that are not `counted`
    have no part in the means (`flashcache.rows`). With `from_diffuse` the rays of the diffuse and
    of the specular half count as much as each other, however many there are. Source: supplement 2.1; the
    distance term is ours (docs/decisions/0004-distance-output.md).
    """
    rgb = (loss_curve(answer.near_radiance) - loss_curve(target.near_radiance.detach())).square().mean(dim=-1)
    opacity = (answer.opacity - target.opacity.detach()).square()
    start, end = (answer.distance.new_full((), limit) for limit in (limits.near, limits.far))
    wanted = SECONDARY_CURVE.normalised(target.distance.detach(), start, end)
    answered = SECONDARY_CURVE.normalised(answer.distance, start, end)
    blocked = (target.opacity.detach() > 0.5).to(rgb.dtype)
    distance = blocked * (wanted - answered).abs()
    loss = inside * (rgb + opacity_weight * opacity + distance_weight * distance)
    if from_diffuse is None:
        return loss.mean() if counted is None else mean_where(loss, counted)
    if counted is not None:
        return 0.5 * (mean_where(loss, counted & from_diffuse) + mean_where(loss, counted & ~from_diffuse))
    halves = (loss[half] for half in (from_diffuse, ~from_diffuse))
    return 0.5 * sum((half.mean() for half in halves if half.numel()), start=loss.new_zeros(()))
