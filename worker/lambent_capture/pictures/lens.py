"""Lenses with distortion, and the pinhole camera that stands in for one.

Coordinates: x right, y down, over depth. Distortion: OpenCV's k1, k2, p1, p2, k3, k4, k5, k6
(https://docs.opencv.org/4.x/d9/d0c/group__calib3d.html).
"""

import functools
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Self

import numpy as np
from jaxtyping import Float, Float64
from lambent_proto.v1 import scene_pb2
from numpy import ndarray

from lambent_capture.arrays import Pose64
from lambent_capture.problems import Problems

NUM_COEFFICIENTS = 8
LEAST_ZOOM, MOST_ZOOM = 0.6, 2.0
"""Range of the pinhole's focal length over that of the lens."""
BORDER_SAMPLES = 65


@dataclass(frozen=True, kw_only=True, slots=True)
class LensFigures:
    """Lens parameters of a picture as given by a layout, in pixels of that picture."""

    width: int
    height: int
    focal_x: float
    focal_y: float
    centre_x: float
    centre_y: float
    distortion: tuple[float, ...] = ()
    """As many coefficients as are known, in OpenCV's order; none for a pinhole."""

    @classmethod
    def centred(cls, size: tuple[int, int], focal: float, distortion: tuple[float, ...] = ()) -> Self:
        """Return a lens without offset for a picture of `size` (width, height), with square pixels."""
        width, height = size
        return cls(
            width=width,
            height=height,
            focal_x=focal,
            focal_y=focal,
            centre_x=0.5 * width,
            centre_y=0.5 * height,
            distortion=distortion,
        )


def distorted(
    x: Float[ndarray, "*batch"], y: Float[ndarray, "*batch"], coefficients: Iterable[float]
) -> tuple[Float[ndarray, "*batch"], Float[ndarray, "*batch"]]:
    """Return where a lens shows what a pinhole shows at (x, y)."""
    k1, k2, p1, p2, k3, k4, k5, k6 = coefficients
    r2 = x * x + y * y
    radial = (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    return (
        x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
        y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
    )


def seen_by_lens(
    camera: scene_pb2.Camera, columns: Float[ndarray, " columns"], rows: Float[ndarray, " rows"]
) -> tuple[Float[ndarray, "rows columns"], Float[ndarray, "rows columns"]]:
    """Return the columns and rows of the lens's picture that show these of its pinhole camera, pixels."""
    x, y = (columns - camera.centre_x) / camera.focal_x, (rows - camera.centre_y) / camera.focal_y
    lens = camera.lens
    seen_x, seen_y = distorted(*np.meshgrid(x, y), np.array(lens.distortion))
    return lens.focal_x * seen_x + lens.centre_x, lens.focal_y * seen_y + lens.centre_y


def camera_with_lens(
    figures: LensFigures, pose: Pose64, subject: str, problems: Problems
) -> scene_pb2.Camera | None:
    """Return the camera of a picture, or None after noting in `problems` what is wrong with its lens.

    A lens with distortion gets a pinhole of the same picture size and optical axis whose focal length is the
    smallest for which every pixel lies inside the picture, so that nothing of it has to be made up.
    """
    numbers = (figures.focal_x, figures.focal_y, figures.centre_x, figures.centre_y, *figures.distortion)
    if not np.isfinite(numbers).all() or min(figures.focal_x, figures.focal_y) <= 0.0:
        problems.error(
            "scene.lens_invalid",
            f"{subject}: focal lengths must be positive numbers, centre and distortion finite ones, found "
            f"fx {figures.focal_x:g}, fy {figures.focal_y:g}, cx {figures.centre_x:g}, "
            f"cy {figures.centre_y:g}; solve the camera again or leave the frame out",
            subject,
        )
        return None
    names = ("width", "height", "focal_x", "focal_y", "centre_x", "centre_y")
    stated = {name: getattr(figures, name) for name in names}
    camera = scene_pb2.Camera(**stated, camera_to_world=pose.ravel().tolist())
    if not any(figures.distortion):
        return camera
    coefficients = _coefficients(figures)
    zoom = _least_zoom(figures)
    if zoom is None:
        problems.error(
            "scene.lens_invalid",
            f"{subject}: the distortion {', '.join(f'{v:g}' for v in figures.distortion)} (k1 k2 p1 p2 ...) "
            "folds the picture over; check order and signs of the coefficients, or undistort the photographs",
            subject,
        )
        return None
    lens = scene_pb2.Lens(**stated, distortion=coefficients.tolist())
    camera.focal_x *= zoom
    camera.focal_y *= zoom
    camera.lens.CopyFrom(lens)
    return camera


def _coefficients(figures: LensFigures) -> Float64[ndarray, "8"]:
    coefficients = np.zeros(NUM_COEFFICIENTS)
    coefficients[: len(figures.distortion)] = figures.distortion
    return coefficients


@functools.lru_cache(maxsize=1024)  # frames of one capture share a few lenses
def _least_zoom(figures: LensFigures) -> float | None:
    """Return the smallest factor on the focal length with which the pinhole sees only what the lens saw."""
    coefficients = _coefficients(figures)
    if not _is_inside(figures, coefficients, MOST_ZOOM):
        return None
    low, high = LEAST_ZOOM, MOST_ZOOM
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if _is_inside(figures, coefficients, middle) else (middle, high)
    return high


def _is_inside(figures: LensFigures, coefficients: Float64[ndarray, "8"], zoom: float) -> bool:
    """Return whether a pinhole with this factor on the focal length stays inside the picture, unfolded."""
    along = np.linspace(0.0, 1.0, BORDER_SAMPLES)
    edges = [
        (along, 0.0 * along),
        (along, 0.0 * along + 1.0),
        (0.0 * along, along),
        (0.0 * along + 1.0, along),
    ]
    u, v = np.concatenate(edges, axis=1)
    x = (u * figures.width - figures.centre_x) / (zoom * figures.focal_x)
    y = (v * figures.height - figures.centre_y) / (zoom * figures.focal_y)
    # From the middle outwards the lens must keep the order of points, or one place is seen twice.
    outwards = np.linspace(0.0, 1.0, BORDER_SAMPLES)[:, None]
    seen_x, seen_y = distorted(outwards * x, outwards * y, coefficients)
    if not np.isfinite(seen_x).all() or not np.isfinite(seen_y).all():
        return False
    radius = np.hypot(seen_x, seen_y)
    if (np.diff(radius, axis=0) <= 0.0).any():
        return False
    columns = figures.focal_x * seen_x[-1] + figures.centre_x
    rows = figures.focal_y * seen_y[-1] + figures.centre_y
    slack = 1e-6
    return bool(
        columns.min() >= -slack
        and rows.min() >= -slack
        and columns.max() <= figures.width + slack
        and rows.max() <= figures.height + slack
    )
