"""Textures looked up the way viewers do it."""

import numpy as np
from numpy.typing import NDArray


def sample_plane(plane: NDArray[np.floating], uv: NDArray[np.floating]) -> NDArray[np.float32]:
    """Return `plane` [size, size, n] at `uv` [count, 2], bilinear, clamped at the rim."""
    height, width = plane.shape[:2]
    x = np.clip(uv[:, 0] * width - 0.5, 0.0, width - 1.0)
    y = np.clip(uv[:, 1] * height - 0.5, 0.0, height - 1.0)
    left = np.minimum(x.astype(np.int32), max(width - 2, 0))
    top = np.minimum(y.astype(np.int32), max(height - 2, 0))
    right, bottom = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1)
    fx, fy = (x - left)[:, None], (y - top)[:, None]
    upper = plane[top, left] * (1.0 - fx) + plane[top, right] * fx
    lower = plane[bottom, left] * (1.0 - fx) + plane[bottom, right] * fx
    return (upper * (1.0 - fy) + lower * fy).astype(np.float32)
