"""Projects points of the scene into a picture file, at any working size, including lens distortion."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from jaxtyping import Float
from lambent_proto.v1 import scene_pb2
from numpy import ndarray


@dataclass(frozen=True, kw_only=True, slots=True)
class PictureCamera:
    """A camera in pixels of a picture; x right, y down, pixel centres at half-integer coordinates."""

    width: int
    height: int
    focal: tuple[float, float]
    centre: tuple[float, float]
    camera_to_world: Float[ndarray, "4 4"]
    distortion: tuple[float, ...] = ()
    """k1, k2, p1, p2, k3, k4, k5, k6 as in the message `Lens`; none for a pinhole."""

    @classmethod
    def of_frame(cls, frame: scene_pb2.Frame) -> Self:
        """Return the camera that took the files of `frame`, before any resampling."""
        pinhole = frame.camera
        taken = pinhole.lens if pinhole.HasField("lens") else pinhole
        return cls(
            width=taken.width,
            height=taken.height,
            focal=(taken.focal_x, taken.focal_y),
            centre=(taken.centre_x, taken.centre_y),
            camera_to_world=np.array(pinhole.camera_to_world, dtype=np.float64).reshape(4, 4),
            distortion=tuple(pinhole.lens.distortion),
        )

    def resized(self, width: int, height: int) -> Self:
        """Return the same camera for the picture at another size."""
        across, down = width / self.width, height / self.height
        return replace(
            self,
            width=width,
            height=height,
            focal=(self.focal[0] * across, self.focal[1] * down),
            centre=(self.centre[0] * across, self.centre[1] * down),
        )

    @property
    def position(self) -> Float[ndarray, "3"]:
        """Return where the camera stands, in scene units."""
        return self.camera_to_world[:3, 3]

    def project(
        self, points: Float[ndarray, "points 3"]
    ) -> tuple[Float[ndarray, " points"], Float[ndarray, " points"], Float[ndarray, " points"]]:
        """Return column and row in pixels and the depth in scene units; depth <= 0 lies behind the camera.

        Far outside of the picture the lens model turns back on itself; such points are put at infinity.
        """
        seen = (points - self.position) @ self.camera_to_world[:3, :3]
        depth = -seen[:, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            column, row = self.bent(seen[:, 0] / depth, -seen[:, 1] / depth)
        return np.nan_to_num(column, nan=np.inf), np.nan_to_num(row, nan=np.inf), depth

    def bent(self, x: ndarray, y: ndarray) -> tuple[ndarray, ndarray]:
        """Return column and row in pixels of rays through (x, y) at depth 1, y downwards; any shape."""
        if any(self.distortion):
            x, y = _distorted(x, y, self.distortion)
        return self.centre[0] + self.focal[0] * x, self.centre[1] + self.focal[1] * y

    def pixels(
        self, points: Float[ndarray, "points 3"]
    ) -> tuple[ndarray, ndarray, Float[ndarray, " points"]]:
        """Return which points the picture shows, their flat pixel indices (0 elsewhere), and all depths."""
        column, row, depth = self.project(points)
        shown = (depth > 0.0) & (column >= 0.0) & (column < self.width) & (row >= 0.0) & (row < self.height)
        index = np.where(shown, row, 0.0).astype(np.int64) * self.width
        index += np.where(shown, column, 0.0).astype(np.int64)
        return shown, index, depth

    def pixels_per_unit(self, point: Float[ndarray, "3"]) -> float:
        """Return the number of pixels per scene unit at `point` (0 behind the camera)."""
        depth = float(-(point - self.position) @ self.camera_to_world[:3, :3][:, 2])
        return max(self.focal) / depth if depth > 0.0 else 0.0


def _distorted(x: ndarray, y: ndarray, distortion: tuple[float, ...]) -> tuple[ndarray, ndarray]:
    k1, k2, p1, p2, k3, k4, k5, k6 = (*distortion, *(0.0,) * 8)[:8]
    square = x * x + y * y
    grown = 1.0 + square * (k1 + square * (k2 + square * k3))
    scale = grown / (1.0 + square * (k4 + square * (k5 + square * k6)))
    # Where the distorted radius decreases again, outside points would be folded into the picture.
    beyond = (1.0 + square * (3.0 * k1 + square * (5.0 * k2 + square * 7.0 * k3)) <= 0.0) & (square > 0.0)
    both = x * y
    bent_x = x * scale + 2.0 * p1 * both + p2 * (square + 2.0 * x * x)
    bent_y = y * scale + p1 * (square + 2.0 * y * y) + 2.0 * p2 * both
    return np.where(beyond, np.inf, bent_x), np.where(beyond, np.inf, bent_y)
