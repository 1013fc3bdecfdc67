"""Finds the plane that the object stands on, in the sparse points of the cameras' solution.

All cameras are on one side of it, hardly any point is on the other, and many lie on it.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from lambent_capture.arrays import Points, Points64, Rotation64, Vector, Vector64


@dataclass(frozen=True, kw_only=True, slots=True)
class PlaneSettings:
    """Settings of the search; lengths are shares of the cameras' distance from what they look at."""

    seed: int = 0
    trials: int = 4000
    reach: float = 1.5
    """Points further from what the cameras look at do not count."""
    thickness: float = 0.004
    """Half the thickness of the plane."""
    below: float = 4.0
    """Points deeper than so many thicknesses are below the plane."""
    cost_below: float = 2.0
    """How many points on the plane one below it outweighs."""
    side_share: float = 0.95
    """Share of the cameras that must be on one side."""
    min_points: int = 30
    min_share: float = 0.04
    """Least share of the near points that lie on the plane."""
    min_spread: float = 0.1
    """Least standard deviation of the points on the plane along its shorter axis; a facet of the object is
    smaller."""
    near: float = 0.35
    """How far from the middle the points above the plane are the object's."""
    beyond_share: float = 0.2
    """Least share of the points on the plane that lie beyond what is above it; a facet's do not."""
    sectors: int = 3
    """Of six around the object, in so many at least there must be some of those points."""
    most_tilt: float = 0.3
    """Least cosine between the normal and the mean direction to the cameras."""


@dataclass(frozen=True, kw_only=True, slots=True)
class SupportPlane:
    """A plane with coordinates on it: right-handed axes, the third is the normal on the cameras' side."""

    origin: Vector64
    """The point of the plane below what the cameras look at."""
    axes: Rotation64
    """Rows: two unit vectors along the plane and the normal."""
    reach: float = 0.0
    """Four fifths of the sparse points on it are nearer to the origin than this, scene units."""

    @property
    def normal(self) -> Vector64:
        """Return the unit normal, on the cameras' side."""
        return self.axes[2]

    def local(self, points: Points) -> Points64:
        """Return points of the scene in coordinates of the plane; the third is the height above it."""
        return (points - self.origin) @ self.axes.T

    def world(self, local: Points) -> Points64:
        """Return points in coordinates of the plane in those of the scene."""
        return self.origin + local @ self.axes


def find_support(
    points: Points,
    positions: Float[ndarray, "cameras 3"],
    centre: Vector,
    distance: float,
    settings: PlaneSettings | None = None,
) -> SupportPlane | None:
    """Return the plane of the support, or None where the points show none.

    `centre` is the point the cameras look at and `distance` how far they are from it, scene units.
    """
    settings = settings or PlaneSettings()
    near = points[np.linalg.norm(points - centre, axis=1) < settings.reach * distance]
    if len(near) < settings.min_points:
        return None
    thickness = settings.thickness * distance
    trial = _best_trial(near, positions, centre, thickness, settings)
    if trial is None:
        return None
    normal, height = trial
    for _ in range(4):
        on = near[np.abs(near @ normal - height) < thickness]
        middle = on.mean(axis=0)
        turned = np.linalg.svd(on - middle, full_matrices=False)[2][2]
        normal = turned * np.sign(turned @ normal)
        height = float(normal @ middle)
    on_plane = np.abs(near @ normal - height) < thickness
    plane = plane_at(centre, normal, height)
    away = np.linalg.norm(plane.local(near[on_plane])[:, :2], axis=1)
    plane = replace(plane, reach=float(np.percentile(away, 80.0)))
    credible = _is_credible(near, on_plane, distance, settings)
    return plane if credible and _reaches_beyond(plane.local(near), on_plane, distance, settings) else None


def plane_at(centre: Vector, normal: Vector, height: float) -> SupportPlane:
    """Return the plane `normal` . x = `height` with its origin at the foot of `centre`."""
    first = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    first /= np.linalg.norm(first)
    axes = np.stack([first, np.cross(normal, first), normal])
    return SupportPlane(origin=centre - (normal @ centre - height) * normal, axes=axes)


def _best_trial(
    near: Points,
    positions: Float[ndarray, "cameras 3"],
    centre: Vector,
    thickness: float,
    settings: PlaneSettings,
) -> tuple[Vector64, float] | None:
    generator = np.random.default_rng(settings.seed)
    corners = near[generator.integers(0, len(near), (settings.trials, 3))]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    keep = lengths > 1e-9 * thickness**2
    normals, corners = normals[keep] / lengths[keep, None], corners[keep]
    heights = (normals * corners[:, 0]).sum(axis=1)
    sides = np.sign(normals @ positions.T - heights[:, None]).sum(axis=1)
    turn = np.where(sides < 0, -1.0, 1.0)
    normals, heights = normals * turn[:, None], heights * turn
    towards = (positions - centre) / np.linalg.norm(positions - centre, axis=1, keepdims=True)
    mean = towards.mean(axis=0)
    facing = normals @ mean >= settings.most_tilt * np.linalg.norm(mean)
    allowed = facing & (np.abs(sides) >= (2.0 * settings.side_share - 1.0) * len(positions))
    best, chosen = 0.0, None
    for normal, height in zip(normals[allowed], heights[allowed], strict=True):
        above = near @ normal - height
        on = np.abs(above) < thickness
        score = on.mean() - settings.cost_below * (above < -settings.below * thickness).mean()
        if score > best:
            best, chosen = float(score), (normal, float(height))
    return chosen


def _is_credible(
    near: Points, on_plane: Bool[ndarray, " points"], distance: float, settings: PlaneSettings
) -> bool:
    if on_plane.sum() < max(settings.min_points, settings.min_share * len(near)):
        return False
    flat = near[on_plane] - near[on_plane].mean(axis=0)
    spread = np.linalg.svd(flat, compute_uv=False)[1] / np.sqrt(on_plane.sum())
    return bool(spread >= settings.min_spread * distance)


def _reaches_beyond(
    local: Points64, on_plane: Bool[ndarray, " points"], distance: float, settings: PlaneSettings
) -> bool:
    """Return whether the plane continues around what stands on it, which a facet of the object does not."""
    radius = np.hypot(local[:, 0], local[:, 1])
    above = local[
        (local[:, 2] > 3.0 * settings.thickness * distance) & (radius < settings.near * distance), :2
    ]
    flat = local[on_plane, :2]
    if len(above) >= 10:
        low, high = np.percentile(above, [3.0, 97.0], axis=0)
        above = above[((above >= low) & (above <= high)).all(axis=1)]
        corners = cv2.convexHull(above.astype(np.float32))
        away = np.array([cv2.pointPolygonTest(corners, (float(x), float(y)), True) for x, y in flat])
        middle, flat = above.mean(axis=0), flat[away < -0.02 * distance]
    else:
        middle = np.zeros(2)
    angles = np.arctan2(flat[:, 1] - middle[1], flat[:, 0] - middle[0])
    sectors = np.bincount(np.clip(((angles + np.pi) / (2.0 * np.pi) * 6.0).astype(int), 0, 5), minlength=6)
    enough = len(flat) >= max(15, settings.beyond_share * on_plane.sum())
    return bool(enough and (sectors >= 2).sum() >= settings.sectors)
