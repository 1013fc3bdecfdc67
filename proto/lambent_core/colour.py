"""Colour between files, screens and us: the sRGB curve, and primaries that a file states.

Everything else is linear Rec. 709; `flashcache.color` is the twin of the curve in torch, with gradients.
Primaries are CIE x and y of red, green, blue and white, in this order. The white is adapted to D65 by the
Bradford transform (ICC.1:2022, annex E), so that grey stays grey.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

REC709_CHROMATICITIES = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)
"""Red, green, blue and white of linear Rec. 709, CIE x and y each."""
CIE_XYZ = (1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0 / 3.0, 1.0 / 3.0)
"""What states that the three channels are X, Y and Z themselves."""
SAME = 2e-3
"""Greatest difference of a coordinate up to which primaries are those of Rec. 709; writers round them."""
_BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])


def srgb_from_linear(linear: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return sRGB-encoded values of linear ones, both clipped to [0, 1]. Source: IEC 61966-2-1."""
    clipped = np.clip(linear, 0.0, 1.0)
    return np.where(clipped <= 0.0031308, 12.92 * clipped, 1.055 * clipped ** (1 / 2.4) - 0.055)


def linear_from_srgb(encoded: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return linear values of sRGB-encoded ones in [0, 1]; the inverse of `srgb_from_linear`."""
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def rec709_matrix(chromaticities: Sequence[float]) -> NDArray[np.float32] | None:
    """Return the matrix from linear colours of these primaries to linear Rec. 709, or None for the same ones.

    Raises ValueError for eight numbers that cannot be primaries: infinite ones, ones on a line, a white
    without luminance.
    """
    stated = np.ravel(np.asarray(chromaticities, np.float64))
    if stated.shape != (8,) or not np.isfinite(stated).all():
        raise ValueError("eight finite numbers are needed")
    if np.abs(stated - REC709_CHROMATICITIES).max() < SAME:
        return None
    if np.abs(stated - CIE_XYZ).max() < SAME:
        # Tristimulus values are of no white, so there is none to adapt.
        return np.linalg.inv(_xyz_from_rgb(np.array(REC709_CHROMATICITIES))).astype(np.float32)
    ours, theirs = _xyz_from_rgb(np.array(REC709_CHROMATICITIES)), _xyz_from_rgb(stated)
    white, their_white = _BRADFORD @ ours.sum(axis=1), _BRADFORD @ theirs.sum(axis=1)
    if np.abs(their_white).min() < 1e-3:
        raise ValueError("the white is none that an eye could adapt to")
    adapted = np.linalg.solve(_BRADFORD, (white / their_white)[:, None] * (_BRADFORD @ theirs))
    return np.linalg.solve(ours, adapted).astype(np.float32)


def to_rec709(rgb: NDArray[np.float32], matrix: NDArray[np.float32] | None) -> NDArray[np.float32]:
    """Return colours [*batch, 3] converted by a matrix of `rec709_matrix`.

    Colours outside Rec. 709 get a negative channel, which no light has: it becomes 0. Where a stored channel
    is negative, infinite or NaN already, all three of the result stay as computed, so that checks find them.
    """
    if matrix is None:
        return rgb
    with np.errstate(invalid="ignore", over="ignore"):
        converted = rgb @ matrix.T
        sound = np.isfinite(rgb).all(axis=-1, keepdims=True) & (rgb >= 0.0).all(axis=-1, keepdims=True)
    return np.where(sound, np.maximum(converted, np.float32(0.0)), converted)


def _xyz_from_rgb(chromaticities: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the matrix to CIE XYZ of a white with Y = 1."""
    corners = np.array([(x, y, 1.0 - x - y) for x, y in chromaticities.reshape(4, 2)]).T
    if abs(corners[1, 3]) < 1e-3 or abs(np.linalg.det(corners[:, :3])) < 1e-4:
        raise ValueError("the primaries span no colours")
    return corners[:, :3] * np.linalg.solve(corners[:, :3], corners[:, 3] / corners[1, 3])
