"""Compares the exposure of pictures by points of the object that several of them show."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray
from scipy import ndimage

from lambent_capture.arrays import Grey, PerView, Points
from lambent_capture.checks.hull import HullVotes
from lambent_capture.scenes.picture_camera import PictureCamera

MAX_POINTS = 4000
DARKEST = 0.01
"""Linear luminance below which noise and rounding decide."""
MIN_COMMON_POINTS = 20
BRIGHTEST = 0.9
"""Linear luminance above which a picture is near its end of the scale."""
_FACING = 0.35
"""Least cosine between the hull's normal and the direction to a camera that is said to see a point."""
_ROUNDS = 12
_SCALE = 0.15
"""Differences of log luminance beyond this count less and less: highlights, wrong depths."""


def surface_luminance(
    hull: HullVotes,
    cells: Bool[ndarray, " points"],
    cameras: Sequence[PictureCamera],
    luminances: Sequence[Grey],
    coverages: Sequence[Grey],
) -> Float[ndarray, "views points"]:
    """Return log2 of the luminance with which views show points of the hull's surface; NaN where they do not.

    A point counts as seen where the hull faces the camera, no other part of the hull lies before it, and the
    pixel shows nothing but the object.
    """
    solid = cells.reshape(hull.shape)
    smooth = ndimage.gaussian_filter(solid.astype(np.float32), 2.0, mode="constant")
    rim = (solid & ~ndimage.binary_erosion(solid)).ravel()
    chosen = np.flatnonzero(rim)
    chosen = chosen[:: max(1, len(chosen) // MAX_POINTS)]
    slopes = np.stack([derivative.ravel()[chosen] for derivative in np.gradient(smooth)], axis=-1)
    normals = -slopes / np.maximum(np.linalg.norm(slopes, axis=-1, keepdims=True), 1e-9)
    points = hull.points[chosen]
    blockers = hull.points[np.flatnonzero(rim)]
    seen = np.full((len(cameras), len(points)), np.nan)
    for view, (camera, luminance, coverage) in enumerate(zip(cameras, luminances, coverages, strict=True)):
        nearest = _depth_map(camera, blockers, hull.spacing)
        shown, index, depth = camera.pixels(points)
        towards = camera.position - points
        cosine = (normals * towards).sum(axis=-1) / np.linalg.norm(towards, axis=-1)
        value = luminance.ravel()[index]
        usable = shown & (cosine > _FACING) & (depth <= nearest.ravel()[index] + 2.0 * hull.spacing)
        usable &= (coverage.ravel()[index] > 0.99) & (value > DARKEST) & (value < BRIGHTEST)
        seen[view, usable] = np.log2(value[usable])
    return seen


def _depth_map(camera: PictureCamera, points: Points, spacing: float) -> Grey:
    """Return the depth of the nearest point in each pixel and around it."""
    shown, index, depth = camera.pixels(points)
    nearest = np.full(camera.width * camera.height, np.inf)
    np.minimum.at(nearest, index[shown], depth[shown])
    radius = 1
    if shown.any():
        radius = max(1, int(np.ceil(0.5 * spacing * camera.pixels_per_unit(points.mean(axis=0)))))
    return ndimage.minimum_filter(nearest.reshape(camera.height, camera.width), size=2 * radius + 1)


@dataclass(frozen=True, slots=True)
class Exposures:
    """Exposure of each view from common points, in EV; 0 where too few of them are visible."""

    offsets: PerView
    """By how much the view is brighter than the others show the same points; the median is 0."""
    mismatch: PerView
    """Median difference that is left once the offset is taken off: large where other points are seen."""


def relative_exposure(seen: Float[ndarray, "views points"]) -> Exposures:
    """Return the differences in brightness between views at common points.

    `seen` is log2 of luminance, NaN where a view does not show a point. Each view gets one offset and each
    point one value; their sum is fitted with weights that forget outliers (iterated least squares).
    """
    known = ~np.isnan(seen)
    known &= known.sum(axis=0) >= 2
    values = np.where(known, seen, 0.0)
    offsets = np.zeros(len(seen))
    residual = np.zeros_like(values)
    weights = known.astype(np.float64)
    for _ in range(_ROUNDS):
        offsets = _fitted(values, weights)
        totals = np.maximum(weights.sum(axis=0), 1e-12)
        base = (weights * (values - offsets[:, None])).sum(axis=0) / totals
        residual = values - offsets[:, None] - base
        weights = known / (1.0 + (residual / _SCALE) ** 2)
    rated = known.sum(axis=1) >= MIN_COMMON_POINTS
    if rated.any():
        offsets = offsets - np.median(offsets[rated])
    mismatch = [
        float(np.median(np.abs(row[mask]))) if mask.any() else 0.0
        for row, mask in zip(residual, known, strict=True)
    ]
    return Exposures(np.where(rated, offsets, 0.0), np.where(rated, np.array(mismatch), 0.0))


def _fitted(values: Float[ndarray, "views points"], weights: Float[ndarray, "views points"]) -> ndarray:
    """Return the offsets of the weighted least squares fit, the points' own values eliminated."""
    per_point = np.maximum(weights.sum(axis=0), 1e-12)
    matrix = np.diag(weights.sum(axis=1)) - (weights / per_point) @ weights.T
    mean = (weights * values).sum(axis=0) / per_point
    right = (weights * (values - mean)).sum(axis=1)
    # One offset common to all is free, and so is that of a view which shares nothing: keep both near zero.
    damping = 1e-6 * max(float(np.diag(matrix).max()), 1e-12)
    return np.linalg.solve(matrix + damping * np.eye(len(matrix)), right)


def deviation_from_neighbours(
    offsets: PerView, directions: Float[ndarray, "views 3"], neighbours: int = 6
) -> PerView:
    """Return by how much each offset differs from the median of the views nearest in direction."""
    if len(offsets) <= neighbours:
        return offsets - np.median(offsets)
    near = np.argsort(-(directions @ directions.T), axis=1)
    others = np.array([row[row != view][:neighbours] for view, row in enumerate(near)])
    return offsets - np.median(offsets[others], axis=1)
