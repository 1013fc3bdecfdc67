"""Losses that compare colour and opacity: rendered with photographed, and the cache with physical estimates.

Colours are linear Rec. 709 unless a name says srgb; every result is a mean over rays.
"""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from flashcache.color import loss_curve

CHARBONNIER_PADDING = 1e-3


def charbonnier(difference: Tensor) -> Tensor:
    """Return `sqrt(d^2 + 0.001^2)`, the smooth absolute value (supplement 2.4)."""
    return torch.sqrt(difference.square() + CHARBONNIER_PADDING**2)


def beyond(
    predicted: Float[Tensor, "rays 3"],
    photograph: Float[Tensor, "rays 3"],
    clipped: Bool[Tensor, "rays 3"] | None,
) -> Float[Tensor, "rays 3"]:
    """Return predicted minus photographed linear colour in sRGB, as far as they contradict each other.

    A clipped channel only says that it was at least as bright: nothing brighter contradicts it.
    """
    difference = loss_curve(predicted) - loss_curve(photograph)
    if clipped is None:
        return difference
    return torch.where(clipped, difference.clamp_max(0.0), difference)


def cache_photometric(
    predicted: Float[Tensor, "rays 3"],
    photograph: Float[Tensor, "rays 3"],
    clipped: Bool[Tensor, "rays 3"] | None = None,
) -> Float[Tensor, ""]:
    """Return the Charbonnier distance of two linear colours in sRGB, the loss of the NeRF cache.

    `clipped` channels of the photograph are lower bounds. Source: supplement 2.4, which has none.
    """
    return charbonnier(beyond(predicted, photograph, clipped)).mean(dim=-1).mean()


def carving(
    premultiplied: Float[Tensor, "rays 3"],
    opacity: Float[Tensor, " rays"],
    photograph: Float[Tensor, "rays 3"],
    coverage: Float[Tensor, " rays"],
    clipped: Bool[Tensor, "rays 3"] | None = None,
) -> Float[Tensor, ""]:
    """Return the loss of the first phase, which carves away matter until the photographs agree.

    On covered pixels the colour is compared after division by opacity, so that a hollow need not
    be opaque at its rim; opacity itself is only kept above 0.6 there and driven to zero outside.
    Differs from the paper: see docs/decisions/0002-shape-first.md.
    """
    colour = premultiplied / opacity.clamp_min(1e-2)[:, None]
    difference = charbonnier(beyond(colour, photograph, clipped)).mean(dim=-1)
    inside = difference + 0.3 * torch.relu(0.6 - opacity)
    loss = torch.where(coverage > 0.99, inside, torch.zeros_like(inside))
    loss = torch.where(coverage < 0.5, 0.3 * opacity, loss)
    return loss.mean()


def mask_loss(
    opacity: Float[Tensor, " rays"],
    coverage: Float[Tensor, " rays"],
) -> Float[Tensor, ""]:
    """Return the Charbonnier distance of rendered opacity and the photograph's coverage."""
    return charbonnier(opacity - coverage).mean()


def physical_photometric(
    photograph: Float[Tensor, "rays 3"],
    estimate_a: Float[Tensor, "rays 3"],
    estimate_b: Float[Tensor, "rays 3"],
    cache: Float[Tensor, "rays 3"],
    ray_weight: Float[Tensor, " rays"],
    clipped: Bool[Tensor, "rays 3"] | None = None,
) -> Float[Tensor, ""]:
    """Return a loss whose mean gradient is that of the squared error of the *mean* picture.

    `estimate_a` carries gradients, `estimate_b` must be independent of it: with the same samples
    the expectation would gain the estimator's variance (supplement Eq. 2). The denominator is
    the tone curve of a raw-noise loss, taken from the cache so that it is free of noise.
    `clipped` channels are left out where both the cache and the other estimate are brighter: the photograph
    does not contradict that. Without `clipped`, as in the paper, they are those at white where the cache
    is brighter than white. The value may be negative.
    """
    scale = torch.maximum(cache, photograph).detach() + 0.01
    if clipped is None:
        agreed = (photograph >= 254.0 / 255.0) & (cache.detach() > 1.0)
    else:
        agreed = clipped & (torch.minimum(cache, estimate_b).detach() > photograph)
    loss = 2.0 * (photograph - estimate_a) * (photograph - estimate_b).detach() / scale
    loss = torch.where(agreed, torch.zeros_like(loss), loss)
    return (loss.mean(dim=-1) * ray_weight).mean()


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
