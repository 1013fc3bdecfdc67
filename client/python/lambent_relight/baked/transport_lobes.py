"""Factors per band by which smoothing with a lobe scales the spherical harmonics of light or visibility.

A lobe around an axis is diagonal in spherical harmonics (Funk-Hecke): band l is multiplied by A_l. The GGX
lobe is that of prefiltering, seen along the normal and the mirror direction at once: D(half angle) times the
cosine, normalised, so that its A_0 is 1. Source: Karis 2013 (Real Shading in Unreal
Engine 4); Ramamoorthi and Hanrahan 2001 for factors per band.
"""

from functools import cache

import numpy as np
from numpy.typing import NDArray

from lambent_relight.baked.transport_kernels import basis_rows

NUM_STEPS = 64
"""Values of perceptual roughness that are tabulated."""
_MIN_ROUGHNESS = 0.02
_NODES, _NODE_WEIGHTS = np.polynomial.legendre.leggauss(512)


@cache
def ggx_bands(bands: int) -> NDArray[np.float32]:
    """Return A_l for perceptual roughness 0 to 1 in equal steps, [NUM_STEPS, bands]."""
    table = np.ones((NUM_STEPS, bands))
    for step, roughness in enumerate(np.linspace(0.0, 1.0, NUM_STEPS)):
        alpha_squared = max(roughness, _MIN_ROUGHNESS) ** 4
        # Substituting the half angle's tangent spreads the nodes of a narrow lobe evenly.
        u = 0.5 * (_NODES + 1.0)
        tan_squared = alpha_squared * u / np.maximum(1.0 - u, 1e-9)
        cosine = (1.0 - tan_squared) / (1.0 + tan_squared)
        # With u uniform, half vectors have density D cos; the light's direction then has density D / 4.
        weight = _NODE_WEIGHTS * np.maximum(cosine, 0.0)
        for degree in range(bands):
            table[step, degree] = np.sum(weight * _legendre(degree, cosine)) / np.sum(weight)
    return table.astype(np.float32)


def factors_at(table: NDArray[np.float32], perceptual_roughness: NDArray[np.floating]) -> NDArray[np.float32]:
    """Return the table's row at every roughness [point], linear between steps: [point, bands]."""
    place = np.clip(perceptual_roughness, 0.0, 1.0) * (len(table) - 1)
    first = np.minimum(place.astype(np.int64), len(table) - 2)
    share = (place - first).astype(np.float32)[:, None]
    return table[first] * (1.0 - share) + table[first + 1] * share


def per_coefficient(factors: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return one factor per coefficient from one per band: [..., bands] -> [..., bands^2]."""
    return np.repeat(factors, 2 * np.arange(factors.shape[-1]) + 1, axis=-1)


def open_share(
    mirror: NDArray[np.floating], perceptual_roughness: NDArray[np.floating], visibility: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Return the unoccluded share of GGX lobes about `mirror` [point, 3], in [0, 1], as [point, 1].

    `visibility` [point, bands^2] is the sky's, as harmonics; `perceptual_roughness` is [point].
    """
    bands = round(visibility.shape[1] ** 0.5)
    lobe = per_coefficient(factors_at(ggx_bands(bands), perceptual_roughness))
    basis = basis_rows(mirror, bands) * lobe
    return np.clip(np.einsum("nk,nk->n", basis, visibility), 0.0, 1.0)[:, None]


def _legendre(degree: int, x: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.polynomial.legendre.legval(x, np.eye(degree + 1)[degree])
