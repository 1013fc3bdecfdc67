"""The objects of the suite: a distance to build the surface from, and a paint that colours its vertices."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tabletop.distance import Distance
from tabletop.objects_dark import cat_distance, cat_paint, robot_distance, robot_paint
from tabletop.objects_toys import elephant_distance, elephant_paint, rabbit_distance, rabbit_paint
from tabletop.objects_vessels import mug_distance, mug_paint, teapot_distance, teapot_paint

Paint = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]
"""Linear base colour [n, 3], perceptual roughness [n] and metalness [n] of points [n, 3] with normals."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Thing:
    """An object that stands on z = 0."""

    distance: Distance
    paint: Paint
    low: tuple[float, float, float]
    high: tuple[float, float, float]

    @property
    def middle(self) -> np.ndarray:
        """Return the middle of the object's box."""
        return 0.5 * (np.array(self.low) + np.array(self.high))

    @property
    def size(self) -> float:
        """Return the length of the longest side of the object's box."""
        return float(np.max(np.array(self.high) - np.array(self.low)))


THINGS = {
    "elephant": Thing(
        distance=elephant_distance, paint=elephant_paint, low=(-1.35, -0.75, -0.02), high=(1.95, 0.75, 2.0)
    ),
    "mug": Thing(distance=mug_distance, paint=mug_paint, low=(-0.52, -0.52, -0.02), high=(0.98, 0.52, 1.05)),
    "teapot": Thing(
        distance=teapot_distance, paint=teapot_paint, low=(-1.6, -0.9, -0.02), high=(1.75, 0.9, 1.9)
    ),
    "rabbit": Thing(
        distance=rabbit_distance, paint=rabbit_paint, low=(-1.05, -0.8, -0.02), high=(1.15, 0.8, 2.9)
    ),
    "cat": Thing(distance=cat_distance, paint=cat_paint, low=(-1.05, -0.75, -0.02), high=(1.0, 0.75, 2.2)),
    "robot": Thing(
        distance=robot_distance, paint=robot_paint, low=(-0.85, -1.05, -0.02), high=(0.8, 1.05, 2.75)
    ),
}
