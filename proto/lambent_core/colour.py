"""The sRGB curve. Everything between files and screens is linear Rec. 709.

`flashcache.color` is the twin in torch, with gradients.
"""

import numpy as np
from numpy.typing import NDArray


def srgb_from_linear(linear: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return sRGB-encoded values of linear ones, both clipped to [0, 1]. Source: IEC 61966-2-1."""
    clipped = np.clip(linear, 0.0, 1.0)
    return np.where(clipped <= 0.0031308, 12.92 * clipped, 1.055 * clipped ** (1 / 2.4) - 0.055)


def linear_from_srgb(encoded: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return linear values of sRGB-encoded ones in [0, 1]; the inverse of `srgb_from_linear`."""
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
