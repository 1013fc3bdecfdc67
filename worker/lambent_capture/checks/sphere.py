"""The sphere of views: the directions from which the object was photographed, and the gaps."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from lambent_capture.arrays import PerView, Vector

NUM_DIRECTIONS = 4000
"""Directions tried as the middle of a gap; they lie about 2.5 degrees apart."""


@dataclass(frozen=True, slots=True)
class Gap:
    """The largest cap of the sphere of views without a camera."""

    radius_deg: float
    """Angle from its middle to the nearest camera."""
    azimuth_deg: float
    """Of its middle; from +x towards +y, -180 to 180."""
    elevation_deg: float
    """Of its middle, above the horizon."""


def unit_directions(positions: Float[ndarray, "views 3"], centre: Vector) -> Float[ndarray, "views 3"]:
    """Return the unit directions from the object to the cameras."""
    offsets = positions - centre
    return offsets / np.maximum(np.linalg.norm(offsets, axis=-1, keepdims=True), 1e-12)


def angles_deg(directions: Float[ndarray, "views 3"]) -> tuple[PerView, PerView]:
    """Return azimuth (from +x towards +y, -180 to 180) and elevation (-90 to 90) of unit directions."""
    azimuth = np.degrees(np.arctan2(directions[:, 1], directions[:, 0]))
    return azimuth, np.degrees(np.arcsin(np.clip(directions[:, 2], -1.0, 1.0)))


def largest_gap(directions: Float[ndarray, "views 3"], *, lowest_deg: float) -> Gap:
    """Return the largest cap without a view whose middle lies at `lowest_deg` elevation or above."""
    tried = fibonacci_sphere(NUM_DIRECTIONS)
    tried = tried[tried[:, 2] >= np.sin(np.radians(lowest_deg)) - 1e-9]
    nearest = np.degrees(np.arccos(np.clip((tried @ directions.T).max(axis=1), -1.0, 1.0)))
    widest = int(nearest.argmax())
    azimuth, elevation = angles_deg(tried[widest : widest + 1])
    return Gap(float(nearest[widest]), float(azimuth[0]), float(elevation[0]))


def fibonacci_sphere(count: int) -> Float[ndarray, "count 3"]:
    """Return `count` unit directions, evenly spread over the sphere, from +z down."""
    z = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    turn = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(count)
    radius = np.sqrt(1.0 - z * z)
    return np.stack([radius * np.cos(turn), radius * np.sin(turn), z], axis=-1)
