"""Smoothing what noise is left in a refined picture, guided by its errors, albedo and normals.

Every pixel becomes a mean over the pixels around it, weighted by how alike they are: patches of radiance may
differ by as much as their standard errors explain (non-local means), and albedo, normal and distance by as
much as a material's texture or a curved surface does. Means are over whole pixels, so the passes of a picture
still add up. It is biased where details are as small as the noise: for looking, never for measuring. Source:
Buades et al. 2005 (non-local means); Rousselle et al. 2012 and 2013 (weights from the noise, and features).
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lambent_relight.picture import RelitPicture


@dataclass(frozen=True, kw_only=True, slots=True)
class Denoiser:
    """How much is smoothed."""

    radius: int = 7
    """Pixels that take part, to either side."""
    strength: float = 0.6
    """Patches of radiance count as alike within this many standard errors of their difference."""
    albedo: float = 0.03
    """Difference of linear albedo at which a neighbour counts 1/e."""
    normal: float = 0.15
    """The same of normals, a length: about that many radians."""
    distance: float = 0.02
    """The same of the distance, as a share of it."""


def denoised(picture: RelitPicture, denoiser: Denoiser | None = None) -> RelitPicture:
    """Return a refined `picture` with less noise: rgb, direct, indirect, diffuse, specular and visibility.

    `standard_error` stays that of the picture before, from which the weights are; without noise nothing
    changes. Pixels that the object does not cover stay as they are.
    """
    # Compiled code takes a second to import, which programs that only look at bundles do not pay.
    from lambent_relight.refined import denoising_kernels as kernels

    settings = denoiser or Denoiser()
    names = ("rgb", "direct", "indirect", "diffuse", "specular", "visibility")
    values = np.concatenate([getattr(picture, name) for name in names], axis=-1, dtype=np.float32)
    features = np.concatenate(
        [
            picture.albedo / settings.albedo,
            picture.normal / settings.normal,
            np.log(np.maximum(picture.distance, 1e-12)) / settings.distance,
        ],
        axis=-1,
        dtype=np.float32,
    )
    out = np.empty_like(values)
    kernels.smooth(
        np.ascontiguousarray(picture.rgb, np.float32),
        _even_variance(picture),
        np.ascontiguousarray(features),
        np.ascontiguousarray(picture.coverage[..., 0], np.float32),
        settings.radius,
        settings.strength,
        np.ascontiguousarray(values),
        out,
    )
    parts = np.split(out, np.cumsum([getattr(picture, name).shape[-1] for name in names])[:-1], axis=-1)
    smooth: dict[str, Any] = dict(zip(names, parts, strict=True))
    return replace(picture, **smooth)


def _even_variance(picture: RelitPicture) -> NDArray[np.float32]:
    """Return the variance of every pixel [height, width, 3], a mean over 3 x 3 covered ones.

    The error of a pixel is itself measured from a few passes.
    """
    weight = (picture.coverage > 0.0).astype(np.float64)
    sums = _box_sums(picture.standard_error.astype(np.float64) ** 2 * weight)
    return (sums / np.maximum(_box_sums(weight), 1.0)).astype(np.float32)


def _box_sums(image: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the sums over 3 x 3 pixels of an image [height, width, n], with nothing beyond its edges."""
    padded = np.pad(image, ((1, 1), (1, 1), (0, 0)))
    rows = padded[:-2] + padded[1:-1] + padded[2:]
    return rows[:, :-2] + rows[:, 1:-1] + rows[:, 2:]
