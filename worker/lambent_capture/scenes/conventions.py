"""Alternative conventions for camera matrices, to report which one a program used."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from numpy import ndarray

from lambent_capture.arrays import Pose64


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Convention:
    """Conversion of a capture's poses from another convention."""

    advice: str
    """Advice, as the end of a sentence."""
    camera_axes: Pose64
    """Multiplied from the right."""
    is_world_to_camera: bool = False
    """Inverted before that."""

    def applied(self, poses: Float64[ndarray, "frames 4 4"]) -> Float64[ndarray, "frames 4 4"]:
        """Return the poses, camera-to-world with camera axes x right, y up, looking along -z."""
        return (np.linalg.inv(poses) if self.is_world_to_camera else poses) @ self.camera_axes


def _turned(*rows: tuple[float, float, float]) -> Pose64:
    matrix = np.eye(4)
    matrix[:3, :3] = rows
    return matrix


_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])

CONVENTIONS = (
    Convention(
        advice="with the other camera axes (OpenCV's against OpenGL's); multiply each from the right by "
        "diag(1, -1, -1, 1)",
        camera_axes=_OPENCV,
    ),
    Convention(
        advice="as world-to-camera matrices; invert each", camera_axes=np.eye(4), is_world_to_camera=True
    ),
    Convention(
        advice="as world-to-camera matrices with the other camera axes; invert each and multiply it from the "
        "right by diag(1, -1, -1, 1)",
        camera_axes=_OPENCV,
        is_world_to_camera=True,
    ),
    Convention(
        advice="with the pictures upside down; multiply each from the right by diag(-1, -1, 1, 1)",
        camera_axes=np.diag([-1.0, -1.0, 1.0, 1.0]),
    ),
    Convention(
        advice="with camera axes x left, y up, z forward; multiply each from the right by diag(-1, 1, -1, 1)",
        camera_axes=np.diag([-1.0, 1.0, -1.0, 1.0]),
    ),
    Convention(
        advice="with the pictures turned by a quarter to the left; save them as the camera held them, "
        "without an EXIF orientation",
        camera_axes=_turned((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
    ),
    Convention(
        advice="with the pictures turned by a quarter to the right; save them as the camera held them, "
        "without an EXIF orientation",
        camera_axes=_turned((0.0, 1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
    ),
)
