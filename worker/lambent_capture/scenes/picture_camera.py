"""Projects points of the scene into a picture file, at any working size, including lens distortion."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from jaxtyping import Float
from lambent_proto.v1 import scene_pb2
from numpy import ndarray

from lambent_capture.arrays import Points, Vector
from lambent_capture.pictures.lens import distorted


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
        camera = cls.of_pinhole(frame.camera)
        if not frame.camera.HasField("lens"):
            return camera
        lens = frame.camera.lens
        return replace(
            camera,
            width=lens.width,
            height=lens.height,
            focal=(lens.focal_x, lens.focal_y),
            centre=(lens.centre_x, lens.centre_y),
            distortion=tuple(lens.distortion),
        )

    @classmethod
    def of_pinhole(cls, camera: scene_pb2.Camera) -> Self:
        """Return a pinhole camera; what its lens does to the files is left out."""
        return cls(
            width=camera.width,
            height=camera.height,
            focal=(camera.focal_x, camera.focal_y),
            centre=(camera.centre_x, camera.centre_y),
            camera_to_world=np.array(camera.camera_to_world, dtype=np.float64).reshape(4, 4),
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
    def position(self) -> Vector:
        """Return where the camera stands, in scene units."""
        return self.camera_to_world[:3, 3]

    def project(
        self, points: Points
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
            x, y = self._distorted(x, y)
        return self.centre[0] + self.focal[0] * x, self.centre[1] + self.focal[1] * y

    def _distorted(self, x: ndarray, y: ndarray) -> tuple[ndarray, ndarray]:
        k1, k2, p1, p2, k3, *rest = (*self.distortion, *(0.0,) * 8)[:8]
        square = x * x + y * y
        # Where the distorted radius decreases again, outside points would be folded into the picture.
        beyond = (1.0 + square * (3.0 * k1 + square * (5.0 * k2 + square * 7.0 * k3)) <= 0.0) & (square > 0.0)
        bent = distorted(x, y, (k1, k2, p1, p2, k3, *rest))
        return np.where(beyond, np.inf, bent[0]), np.where(beyond, np.inf, bent[1])

    def pixels(self, points: Points) -> tuple[ndarray, ndarray, Float[ndarray, " points"]]:
        """Return which points the picture shows, their flat pixel indices (0 elsewhere), and all depths."""
        column, row, depth = self.project(points)
        shown = (depth > 0.0) & (column >= 0.0) & (column < self.width) & (row >= 0.0) & (row < self.height)
        index = np.where(shown, row, 0.0).astype(np.int64) * self.width
        index += np.where(shown, column, 0.0).astype(np.int64)
        return shown, index, depth

    def pixels_per_unit(self, point: Vector) -> float:
        """Return the number of pixels per scene unit at `point` (0 behind the camera)."""
        depth = float(-(point - self.position) @ self.camera_to_world[:3, :3][:, 2])
        return max(self.focal) / depth if depth > 0.0 else 0.0
