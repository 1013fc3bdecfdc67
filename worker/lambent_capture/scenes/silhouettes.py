"""The space that all masks allow for the object: a grid of points, carved by the cameras.

A point belongs to the hull when almost every camera that shows it shows it inside the mask. Poses that follow
another convention leave too little to explain the masks, which is how wrong axes are found.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float64
from lambent_proto.v1 import scene_pb2
from numpy import ndarray
from scipy.ndimage import maximum_filter

from lambent_capture.arrays import Grey, Points64, Region, Vector64
from lambent_capture.scenes.conventions import CONVENTIONS, Convention
from lambent_capture.scenes.extent import looked_at_point, stand_apart
from lambent_capture.scenes.picture_camera import PictureCamera

MASK_SIDE = 96
"""Longer side of the masks used here, pixels."""
FIRST_GRID, SECOND_GRID = 28, 44
"""Points along each side of the grid that finds the object and of the one that covers it."""
START = 0.6
"""Half the side of the first grid, as a share of the distance between cameras and object."""
OUTSIDE_SHARE = 0.02
"""Share of the cameras showing a point that may show it outside the mask."""
ONE_MAY_DIFFER_FROM = 20
"""Number of cameras showing a point from which on one may differ, however small its share."""
LEAST_SEEN = 0.5
"""Share of the cameras that must show a point."""
INSIDE = 0.5
"""Coverage from which on a pixel counts as the object."""
AGREEMENT = 0.98
"""Share of a mask that the hull explains in a sound capture (it is 1 but for noise and small errors)."""
SINGLE_AGREEMENT = 0.95
"""The same for the worst single mask."""


@dataclass(frozen=True, slots=True, eq=False)
class Silhouette:
    """The part of a picture that shows the object."""

    camera: PictureCamera
    """In pixels of `mask`."""
    mask: Region
    name: str = ""
    """Of the frame."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Hull:
    """Grid points inside all silhouettes, scene units."""

    points: Points64
    spacing: Vector64
    """Distance between neighbours."""
    open_low: Bool[ndarray, "3"]
    """Sides on which it reaches the border of the searched volume, so that it may be larger."""
    open_high: Bool[ndarray, "3"]

    @property
    def box(self) -> tuple[Vector64, Vector64]:
        """Return the corners of the box around all cells."""
        return self.points.min(axis=0) - 0.5 * self.spacing, self.points.max(axis=0) + 0.5 * self.spacing


def silhouette_of(frame: scene_pb2.Frame, coverage: Grey) -> Silhouette:
    """Return a frame's silhouette; `coverage` is that of the pinhole's whole picture, at any size."""
    height, width = coverage.shape
    camera = PictureCamera.of_pinhole(frame.camera).resized(width, height)
    return Silhouette(camera, coverage > INSIDE, frame.name)


def carve(views: Sequence[Silhouette], one_may_differ_from: int = ONE_MAY_DIFFER_FROM) -> Hull | None:
    """Return the hull of the object the cameras surround, or None where the masks leave no point.

    Cameras showing a point inside the mask must be all but 2 %, or all but one where at least
    `one_may_differ_from` show it.

    The first grid reaches 0.6 times the distance of the cameras to each side of the point they look at; the
    second one covers what is left, so its points are as fine as the object allows.
    """
    positions = np.stack([view.camera.position for view in views])
    centre = looked_at_point(positions, -np.stack([view.camera.camera_to_world[:3, 2] for view in views]))
    if centre is None:
        return None
    reach = START * float(np.median(np.linalg.norm(positions - centre, axis=-1)))
    first = _carved(views, centre - reach, centre + reach, FIRST_GRID, one_may_differ_from)
    if first is None:
        return None
    low, high = first.box
    open_low = low < centre - reach + first.spacing
    open_high = high > centre + reach - first.spacing
    second = _carved(views, low - first.spacing, high + first.spacing, SECOND_GRID, one_may_differ_from)
    return None if second is None else replace(second, open_low=open_low, open_high=open_high)


def explained(views: Sequence[Silhouette], hull: Hull | None) -> Float64[ndarray, " views"]:
    """Return for each view the share of its mask that the hull covers: 1 where everything fits."""
    if hull is None:
        return np.zeros(len(views))
    shares = []
    for view in views:
        shown, index, depth = view.camera.pixels(hull.points)
        covered = np.zeros(view.mask.shape, dtype=bool)
        covered.flat[index[shown]] = True
        if shown.any():
            covered = maximum_filter(covered, _footprint(view, hull.spacing, float(depth[shown].min())))
        shares.append((covered & view.mask).sum() / max(int(view.mask.sum()), 1))
    return np.array(shares)


def other_convention(views: Sequence[Silhouette], better_than: float) -> Convention | None:
    """Return the convention under which the poses explain the masks best, or None where none does.

    It must explain every mask but for noise, and on average more than the share `better_than`.
    """
    poses = np.stack([view.camera.camera_to_world for view in views])
    best: Convention | None = None
    for convention in CONVENTIONS:
        applied = convention.applied(poses)
        centre = looked_at_point(applied[:, :3, 3], -applied[:, :3, 2])
        # Cameras on one spot would explain anything.
        if centre is None or not stand_apart(applied[:, :3, 3], centre):
            continue
        turned = [
            replace(view, camera=replace(view.camera, camera_to_world=pose))
            for view, pose in zip(views, applied, strict=True)
        ]
        shares = explained(turned, carve(turned))
        if (
            np.median(shares) >= AGREEMENT
            and shares.min() >= SINGLE_AGREEMENT
            and shares.mean() > better_than
        ):
            best, better_than = convention, float(shares.mean())
    return best


def _carved(
    views: Sequence[Silhouette], low: Vector64, high: Vector64, size: int, one_may_differ_from: int
) -> Hull | None:
    spacing = (high - low) / size
    axes = [low[i] + (np.arange(size) + 0.5) * spacing[i] for i in range(3)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    num_seen = np.zeros(len(points), dtype=np.int32)
    num_outside = np.zeros(len(points), dtype=np.int32)
    for view in views:
        shown, index, depth = view.camera.pixels(points)
        if not shown.any():
            continue
        # Widened by the size of a cell, so that nothing thinner than a cell is lost.
        mask = maximum_filter(view.mask, _footprint(view, spacing, float(np.median(depth[shown]))))
        num_seen += shown
        num_outside += shown & ~mask.ravel()[index]
    allowed = np.where(num_seen >= one_may_differ_from, np.maximum(1.0, OUTSIDE_SHARE * num_seen), 0.0)
    kept = (num_seen >= max(3.0, LEAST_SEEN * len(views))) & (num_outside <= allowed)
    if not kept.any():
        return None
    closed = np.zeros(3, dtype=bool)
    return Hull(points=points[kept], spacing=spacing, open_low=closed, open_high=closed)


def _footprint(view: Silhouette, spacing: Vector64, distance: float) -> int:
    """Return the width of the square of pixels that a cell at this distance fits in, an odd number."""
    pixels = float(np.linalg.norm(spacing)) * max(view.camera.focal) / max(distance, 1e-12)
    return min(2 * int(np.ceil(0.5 * pixels)) + 1, 2 * max(view.mask.shape) + 1)
