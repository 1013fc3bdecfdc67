"""Draws the outline of a mask exactly, by the colours on both sides of it."""

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray
from scipy import ndimage

from lambent_capture.arrays import Grey, Region
from lambent_capture.checks.hull import grown

_SURE = 3.0
"""Window in which colours are compared, in widths of the doubtful band (standard deviation of a Gaussian)."""
_BACKGROUND_NOISE = 2.0
_OBJECT_NOISE = 25.0
"""Least variance of the colours on either side, CIELAB squared. The object's is wide: an edge shows parts of
it that are nowhere else."""
_SURPRISE = 0.4
"""Share of an object's rim that has a colour of its own."""
_LOG_UNIFORM = -1.5 * np.log(60.0) - 3.0
"""Log density of such a colour, up to the same constant as the Gaussians'."""


def refine_outline(lab: Float[ndarray, "height width 3"], belief: Grey, band: int) -> Grey:
    """Return the belief (0..1) with every pixel within `band` of its outline judged by colour.

    Each is compared with the colours near it on the sure sides. Where they are alike, the belief decides.
    Further away it becomes 0 or 1.
    """
    mask = belief > 0.5
    inside, outside = ~grown(~mask, band), ~grown(mask, band)
    doubtful = ~inside & ~outside
    result = inside.astype(np.float64)
    if not inside.any() or not outside.any():
        return np.where(doubtful, belief, result)
    sigma = max(_SURE * band, 4.0) / 1.5
    pixels = lab[doubtful]
    background, known_background = _log_density(lab, outside, doubtful, pixels, sigma, _BACKGROUND_NOISE)
    foreground, known_foreground = _log_density(lab, inside, doubtful, pixels, sigma, _OBJECT_NOISE)
    own = np.logaddexp(foreground + np.log(1.0 - _SURPRISE), np.log(_SURPRISE) + _LOG_UNIFORM)
    odds = np.where(known_background & known_foreground, np.clip(own - background, -4.0, 4.0), 0.0)
    before = np.clip(belief[doubtful], 1e-3, 1.0 - 1e-3)
    odds += np.clip(np.log(before / (1.0 - before)), -2.0, 2.0)
    result[doubtful] = 1.0 / (1.0 + np.exp(-odds))
    return np.where(doubtful, ndimage.gaussian_filter(result, 0.6), result)


def _log_density(
    lab: Float[ndarray, "height width 3"],
    sure: Region,
    doubtful: Region,
    pixels: Float[ndarray, "pixels 3"],
    sigma: float,
    noise: float,
) -> tuple[Float[ndarray, " pixels"], Bool[ndarray, " pixels"]]:
    """Return the log density of doubtful pixels under a Gaussian of the sure colours around each.

    Also whether there are any sure pixels near enough. The constant of the Gaussian is left out.
    """
    weights = sure.astype(np.float64)

    def around(values: ndarray) -> ndarray:
        return ndimage.gaussian_filter(values * weights, sigma)[doubtful]

    total = ndimage.gaussian_filter(weights, sigma)[doubtful]
    scale = 1.0 / np.maximum(total, 1e-9)
    mean = np.stack([around(lab[..., i]) * scale for i in range(3)], axis=-1)
    covariance = np.empty((len(pixels), 3, 3))
    for i in range(3):
        for j in range(i, 3):
            product = around(lab[..., i] * lab[..., j]) * scale - mean[:, i] * mean[:, j]
            covariance[:, i, j] = covariance[:, j, i] = product
    covariance += noise * np.eye(3)
    offset = pixels - mean
    square = (offset * np.linalg.solve(covariance, offset[..., None])[..., 0]).sum(axis=-1)
    return -0.5 * (square + np.linalg.slogdet(covariance)[1]), total > 1e-4
