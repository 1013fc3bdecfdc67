"""Quadrature of the volume rendering equation and its estimator from K of the N points."""

from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor


def render_weights(
    density: Float[Tensor, "rays samples"], distances: Float[Tensor, "rays edges"]
) -> Float[Tensor, "rays samples"]:
    """Return the share of each interval in the radiance at the ray's start.

    `density` is in 1/scene unit, `distances` are the interval edges along unit directions.
    The shares sum to at most one; what is missing belongs to the background.
    Source: paper Eq. 3.
    """
    depth = density * (distances[:, 1:] - distances[:, :-1])
    before = torch.nn.functional.pad(depth[:, :-1].cumsum(dim=-1), (1, 0))
    return -torch.expm1(-depth) * torch.exp(-before)


def composite(
    weights: Float[Tensor, "rays samples"], values: Float[Tensor, "points channels"]
) -> Float[Tensor, "rays channels"]:
    """Return the weighted sum along each ray of values given point by point, ray after ray (paper Eq. 3)."""
    num_rays, num_samples = weights.shape
    return (weights[..., None] * values.reshape(num_rays, num_samples, -1)).sum(dim=1)


class PointDraw(NamedTuple):
    """K of the N quadrature points of each ray, drawn in proportion to their weights."""

    index: Int[Tensor, "rays points"]  # type: ignore[assignment]  # hides `tuple.index`
    """Position of the drawn point among the ray's samples."""
    weight: Float[Tensor, "rays points"]
    """Factor of the point's radiance: value acc/K, gradient unbiased for the full sum."""


def draw_points(
    weights: Float[Tensor, "rays samples"], u: Float[Tensor, "rays points"], *, sure_from: float = 0.0
) -> PointDraw:
    """Return K points per ray such that `sum_k weight_k L(x_k)` is unbiased for the full quadrature.

    `u` holds uniform variates in [0, 1), K per ray. A ray with an opacity below 1e-8 gets
    its first point with weight zero. So does one less opaque than `sure_from`, but for a share of its
    draws, its opacity over `sure_from`, which count for the others (Russian roulette). The weight
    `w_j / sg(K pi_j)` has the value acc/K, and its gradient with respect to the render weights is the
    full sum's, in the mean.
    Source: paper Eq. 11.
    """
    frozen = weights.detach()
    cdf = frozen.cumsum(dim=-1)
    acc = cdf[:, -1:]
    empty = acc < 1e-8
    if sure_from > 0.0:
        kept = (acc / sure_from).clamp(1e-12, 1.0)
        empty, u = empty | (u >= kept), (u / kept).clamp_max(1.0)
    index = torch.searchsorted(cdf, u * acc, right=True).clamp_max(weights.shape[-1] - 1)
    index = torch.where(empty, torch.zeros_like(index), index)
    probability = frozen.gather(-1, index) / acc.clamp_min(1e-8)
    if sure_from > 0.0:
        probability = probability * kept
    drawn = weights.gather(-1, index) / (u.shape[-1] * probability.clamp_min(1e-12))
    return PointDraw(index, torch.where(empty, torch.zeros_like(drawn), drawn))


def median_point(
    weights: Float[Tensor, "rays samples"],
) -> PointDraw:
    """Return the point where the accumulated weight passes half, carrying all of the opacity.

    This is the biased estimator of the ablation `estimator=depth`.
    """
    cdf = weights.detach().cumsum(dim=-1)
    index = torch.searchsorted(cdf, 0.5 * cdf[:, -1:]).clamp_max(weights.shape[-1] - 1)
    return PointDraw(index, weights.sum(dim=-1, keepdim=True))
