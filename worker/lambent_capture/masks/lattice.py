"""A box of cubic cells, in any orientation, and where pictures see its cells."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int32
from numpy import ndarray
from scipy import ndimage

from lambent_capture.arrays import Points64, Rotation64, Vector64
from lambent_capture.scenes.picture_camera import PictureCamera


@dataclass(frozen=True, kw_only=True, slots=True)
class Frame:
    """Coordinates in which boxes are upright."""

    origin: Vector64
    axes: Rotation64
    """Rows: unit vectors."""

    def world(self, local: Points64) -> Points64:
        """Return points in scene coordinates."""
        return self.origin + local @ self.axes


SCENE = Frame(origin=np.zeros(3), axes=np.eye(3))
"""The coordinates of the scene themselves."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Lattice:
    """Cells in the order of an array of `shape`."""

    frame: Frame
    low: Vector64
    """Lower corner of the box in coordinates of `frame`."""
    spacing: float
    """Side of a cell, scene units."""
    shape: tuple[int, int, int]

    @classmethod
    def between(cls, frame: Frame, low: Vector64, high: Vector64, cells: int) -> "Lattice":
        """Return the lattice with `cells` cells along the longest side of the box."""
        spacing = float((high - low).max()) / cells
        counts = np.maximum(np.ceil((high - low) / spacing - 1e-6).astype(int), 1)
        shape = (int(counts[0]), int(counts[1]), int(counts[2]))
        return cls(frame=frame, low=low, spacing=spacing, shape=shape)

    @property
    def size(self) -> int:
        """Return the number of cells."""
        return int(np.prod(self.shape))

    def local(self, chosen: Bool[ndarray, " cells"]) -> Float64[ndarray, "chosen 3"]:
        """Return the centres of chosen cells in coordinates of `frame`."""
        places = np.stack(np.unravel_index(np.flatnonzero(chosen), self.shape), axis=-1)
        return self.low + (places + 0.5) * self.spacing

    def pixels(self, camera: PictureCamera) -> Int32[ndarray, " cells"]:
        """Return the flat index of the pixel that shows each cell's centre, -1 outside of the picture.

        Single precision: right to about a hundredth of a pixel. The terms of the projection are linear
        in the cell's three indices, so they are added up along the axes of the array.
        """
        turn = camera.camera_to_world[:3, :3].T
        start = turn @ (self.frame.world(self.low + 0.5 * self.spacing) - camera.position)
        steps = self.spacing * (turn @ self.frame.axes.T)
        x, y, back = (
            (
                start[i]
                + steps[i, 0] * np.arange(self.shape[0])[:, None, None]
                + steps[i, 1] * np.arange(self.shape[1])[None, :, None]
                + steps[i, 2] * np.arange(self.shape[2])[None, None, :]
            ).astype(np.float32)
            for i in range(3)
        )
        depth = np.maximum(-back, np.float32(1e-6))
        x, y = x / depth, -y / depth
        column, row = camera.bent(x, y)
        shown = (back < 0) & (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
        flat = np.where(shown, row, 0).astype(np.int32) * camera.width
        flat += np.where(shown, column, 0).astype(np.int32)
        return np.where(shown, flat, -1).astype(np.int32).ravel()


def main_parts(
    solid: Bool[ndarray, " cells"], lattice: Lattice, focus: Vector64, distance: float
) -> Bool[ndarray, " cells"]:
    """Return the connected parts of `solid` that are large and near `focus` (in the lattice's frame).

    A cell counts e times less at a fifth of the cameras' `distance`, horizontally. Parts that count less than
    a seventh of the most important one are left out: they are clutter next to the object.
    """
    labels, number = ndimage.label(solid.reshape(lattice.shape))
    if number <= 1:
        return solid
    away = lattice.local(solid)[:, :2] - focus[:2]
    weight = np.exp(-(away**2).sum(axis=1) / (0.2 * distance) ** 2)
    part = labels.ravel()
    scores = np.bincount(part[solid], weight, minlength=number + 1)
    scores[0] = 0.0
    return np.asarray((scores >= scores.max() / 7.0)[part] & solid)
