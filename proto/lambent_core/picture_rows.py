"""A decoded picture whose rows are converted to numbers on demand, so that large ones can be reduced."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lambent_core.directions import pixel_solid_angles


@dataclass(frozen=True)
class PictureRows:
    """A picture of `height` x `width` pixels."""

    height: int
    width: int
    rows: Callable[[slice], NDArray[np.float32]]
    """Linear values of some rows, [row, width, 3]."""
    layout: str | None = None
    """The layout of an environment that the file states, if it does: "latlong", or "cube" as in OpenEXR."""


def block_means(picture: PictureRows, step: int) -> NDArray[np.float32]:
    """Return the means over blocks of `step` x `step` pixels, weighted with solid angle.

    `step` must divide both sides. A value that is not a number spoils its own block only.
    """
    if step == 1:
        return picture.rows(slice(0, picture.height))
    height, width = picture.height // step, picture.width // step
    weights = pixel_solid_angles(picture.height, picture.width).reshape(height, step)
    weights = (weights / weights.sum(axis=1, keepdims=True)).astype(np.float32)
    result = np.empty((height, width, 3), np.float32)
    for row in range(height):
        band = picture.rows(slice(row * step, (row + 1) * step)).reshape(step, width, step, 3)
        result[row] = np.einsum("r,rwsc->wc", weights[row], band) / np.float32(step)
    return result
