"""The sRGB curve and the roughness conversion; everything else in this package is linear and uses `alpha`."""

import torch
from jaxtyping import Float
from torch import Tensor

_LINEAR_KNEE = 0.0031308
_SRGB_KNEE = 0.04045
LOSS_FLOOR = 1e-5
"""Smallest linear value that `loss_curve` tells apart from darker ones."""


def srgb_from_linear(linear: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """Return values encoded with the sRGB transfer function.

    Not clipped: values above 1 stay above 1, negative ones follow the straight part.
    Source: IEC 61966-2-1, with the power segment's slope floored only where it is not used.
    """
    power = 1.055 * linear.clamp_min(_LINEAR_KNEE).pow(1.0 / 2.4) - 0.055
    return torch.where(linear <= _LINEAR_KNEE, 12.92 * linear, power)


def linear_from_srgb(srgb: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """Return linear values from sRGB-encoded ones; the inverse of `srgb_from_linear`."""
    power = ((srgb.clamp_min(_SRGB_KNEE) + 0.055) / 1.055).pow(2.4)
    return torch.where(srgb <= _SRGB_KNEE, srgb / 12.92, power)


def loss_curve(linear: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """Return radiance on the scale on which losses compare it: the sRGB curve of max(., 1e-5).

    Not clipped above. The gradient is zero below the floor. Source: the authors' public code, which
    compares radiance in sRGB.
    """
    return srgb_from_linear(linear.clamp_min(LOSS_FLOOR))


def perceptual_roughness_from_alpha(alpha: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """Return the perceptual roughness (0..1, what files carry) of a GGX width `alpha` (what is learned)."""
    return alpha.sqrt()


def alpha_from_perceptual_roughness(perceptual_roughness: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """Return the GGX width `alpha` of a perceptual roughness (0..1)."""
    return perceptual_roughness.square()
