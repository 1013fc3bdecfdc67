"""Depth discontinuities in a view: outlines of parts of the object in front of other parts."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lambent_relight.baked.view import BakedView

_LEAST_STEP = 4.0
"""Depth differences above this many times the distance between two pixels on the surface are edges."""
_SAME_PART = 0.25
"""A pixel belongs to a step's near or far side if it is no farther from it than this share of the step."""


@dataclass(frozen=True, eq=False)
class DepthSteps:
    """Depth discontinuities of a view; indices of pixels in the view, [step] each."""

    at: NDArray[np.int64]
    near: NDArray[np.int64]
    """The pixel that shows the near side: `at` itself or one of its eight neighbours."""
    far: NDArray[np.int64]

    def __getitem__(self, which: NDArray[np.bool_]) -> "DepthSteps":
        """Return some of the steps."""
        return DepthSteps(self.at[which], self.near[which], self.far[which])


def depth_steps(view: BakedView) -> DepthSteps:
    """Return the depth steps of a view, sorted by pixel.

    One over the depth of a plane is linear in a picture, so second differences of it show steps and creases,
    however slanted the surface is.
    """
    camera = view.camera
    number = pixel_numbers(view)
    depth = view.distance[:, 0] * (view.omega_o @ camera.camera_to_world[:3, 2])
    inverse = np.where(number >= 0, 1.0 / np.maximum(depth, 1e-9)[np.maximum(number, 0)], np.nan)
    bent = np.zeros((camera.height, camera.width), bool)
    for axis in (0, 1):
        ahead, behind = (np.roll(inverse, shift, axis)[1:-1, 1:-1] for shift in (1, -1))
        middle = inverse[1:-1, 1:-1]
        # In units of the distance between two pixels at this depth.
        with np.errstate(invalid="ignore"):
            bent |= np.abs(ahead + behind - 2.0 * middle) / middle * camera.focal_x > _LEAST_STEP
    at = np.flatnonzero(bent.ravel()[view.pixel])
    row, column = np.divmod(view.pixel[at], camera.width)
    beside = np.stack([number[row + 1 + dr, column + 1 + dc] for dr in (-1, 0, 1) for dc in (-1, 0, 1)])
    distance = np.where(beside >= 0, view.distance[np.maximum(beside, 0), 0], np.nan)
    every = np.arange(len(at))
    near, far = (beside[pick(distance, axis=0), every] for pick in (np.nanargmin, np.nanargmax))
    own, front, back = (view.distance[which, 0] for which in (at, near, far))
    step = back - front
    near = np.where(own - front < _SAME_PART * step, at, near)
    far = np.where(back - own < _SAME_PART * step, at, far)
    return DepthSteps(at, near, far)[step * camera.focal_x > _LEAST_STEP * own]


def pixel_numbers(view: BakedView) -> NDArray[np.int64]:
    """Return the number in `view` of every pixel of its camera, -1 where there is none, and -1 around it."""
    height, width = view.camera.height, view.camera.width
    number = np.full((height + 2, width + 2), -1, np.int64)
    row, column = np.divmod(view.pixel, width)
    number[row + 1, column + 1] = np.arange(view.num_pixels)
    return number
