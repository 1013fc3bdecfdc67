"""Finds sparse points for cameras that are known: features of neighbouring views that fit the geometry.

Enough to find the plane that an object stands on and what is above it. COLMAP would do the same by a
database of files; here photographs are read as everywhere else, and the work can be interrupted between two.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float64, Int
from numpy import ndarray

from lambent_capture.arrays import Points64, Vector, Vector64
from lambent_capture.masks.photograph import Photograph, Progress, SparsePoints
from lambent_capture.masks.plane_maps import straightened
from lambent_capture.scenes.picture_camera import PictureCamera


@dataclass(frozen=True, kw_only=True, slots=True)
class TriangulateSettings:
    """Settings of features, pairs and points."""

    side: int = 800
    """Longer side at which features are looked for, pixels."""
    features: int = 2000
    """Per photograph."""
    contrast: float = 0.02
    """Least contrast of a feature; half of the usual, since supports are often plain."""
    partners: int = 4
    """Other views that each view is compared with: the next ones in direction that are far enough."""
    least_deg: float = 3.0
    """Least angle between the rays to a point."""
    most_deg: float = 45.0
    """Views that see the middle of the scene under a larger angle are not compared."""
    ratio: float = 0.85
    """How much better the best match must be than the next one; the geometry rules out the rest."""
    error_px: float = 1.5
    """Largest distance of a point from where either view sees it."""


@dataclass(frozen=True, slots=True)
class _Features:
    camera: PictureCamera
    pixels: Float64[ndarray, "features 2"]
    rays: Float64[ndarray, "features 3"]
    descriptors: ndarray


def triangulate(
    photographs: Sequence[Photograph],
    centre: Vector,
    settings: TriangulateSettings | None = None,
    progress: Progress = lambda phase, done, total: None,
) -> SparsePoints:
    """Return points that two views agree on, scene units; `centre` is what the cameras look at.

    There may be none where photographs show nothing that can be recognised.
    """
    settings = settings or TriangulateSettings()
    features = []
    for number, photograph in enumerate(photographs):
        features.append(_features(photograph, settings))
        progress("looking for points", number + 1, len(photographs))
    positions = np.array([photograph.camera.position for photograph in photographs])
    pairs = neighbours(positions - centre, settings)
    points, seen = [np.zeros((0, 3))], []
    for number, (first, second) in enumerate(pairs):
        new = _shared_points(features[first], features[second], settings)
        points.append(new)
        seen.extend([(first, second)] * len(new))
        progress("placing points", number + 1, len(pairs))
    return SparsePoints(xyz=np.concatenate(points), seen_by=tuple(seen))


def neighbours(offsets: Float64[ndarray, "views 3"], settings: TriangulateSettings) -> list[tuple[int, int]]:
    """Return pairs of views to compare, given the cameras' positions relative to what they look at."""
    directions = offsets / np.maximum(np.linalg.norm(offsets, axis=1, keepdims=True), 1e-12)
    angles = np.degrees(np.arccos(np.clip(directions @ directions.T, -1.0, 1.0)))
    pairs = set()
    for view, row in enumerate(angles):
        usable = np.flatnonzero((row >= settings.least_deg) & (row <= settings.most_deg))
        nearest = usable[np.argsort(row[usable])][: settings.partners]
        pairs |= {(min(view, int(other)), max(view, int(other))) for other in nearest}
    return sorted(pairs)


def _features(photograph: Photograph, settings: TriangulateSettings) -> _Features:
    view = photograph.reduced(settings.side)
    grey = cv2.cvtColor(view.image_srgb, cv2.COLOR_RGB2GRAY)
    finder = cv2.SIFT.create(nfeatures=settings.features, contrastThreshold=settings.contrast)
    keypoints, descriptors = finder.detectAndCompute(grey, None)
    if descriptors is None or not len(keypoints):
        return _Features(view.camera, np.zeros((0, 2)), np.zeros((0, 3)), np.zeros((0, 128), np.float32))
    # Pixel centres are at whole numbers for `cv2`, at halves for our cameras.
    pixels = np.array([keypoint.pt for keypoint in keypoints]) + 0.5
    # Root-SIFT: Arandjelovic and Zisserman, Three things everyone should know, CVPR 2012.
    descriptors = np.sqrt(descriptors / np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-7))
    return _Features(view.camera, pixels, _rays(view.camera, pixels), descriptors.astype(np.float32))


def _rays(camera: PictureCamera, pixels: Float64[ndarray, "features 2"]) -> Float64[ndarray, "features 3"]:
    """Return unit directions through pixels, scene coordinates, distortion undone."""
    seen = straightened(camera, pixels)
    local = np.column_stack([seen[:, 0], -seen[:, 1], -np.ones(len(seen))])
    rays = local @ camera.camera_to_world[:3, :3].T
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))


def _shared_points(first: _Features, second: _Features, settings: TriangulateSettings) -> Points64:
    matches = _matches(first.descriptors, second.descriptors, settings.ratio)
    one, other = first.rays[matches[:, 0]], second.rays[matches[:, 1]]
    points = _between(first.camera.position, one, second.camera.position, other)
    wide = np.degrees(np.arccos(np.clip((one * other).sum(axis=1), -1.0, 1.0))) >= settings.least_deg
    right = wide & np.isfinite(points).all(axis=1)
    for features, chosen in ((first, matches[:, 0]), (second, matches[:, 1])):
        column, row, depth = features.camera.project(np.nan_to_num(points))
        off = np.hypot(column - features.pixels[chosen, 0], row - features.pixels[chosen, 1])
        right &= (depth > 0.0) & (off <= settings.error_px)
    return np.asarray(points[right])


def _matches(first: ndarray, second: ndarray, ratio: float) -> Int[ndarray, "matches 2"]:
    """Return the rows that are each other's best match, clearly better than the next."""
    if len(first) < 2 or len(second) < 2:
        return np.zeros((0, 2), dtype=np.int64)
    likeness = first @ second.T
    best = likeness.argmax(axis=1)
    rows = np.arange(len(first))
    top = likeness[rows, best]
    mutual = likeness.argmax(axis=0)[best] == rows
    likeness[rows, best] = -1.0
    # Descriptors have length 1, so squared distances are 2 - 2 x likeness.
    clear = (1.0 - top) <= ratio**2 * (1.0 - likeness.max(axis=1))
    chosen = np.flatnonzero(mutual & clear)
    return np.column_stack([chosen, best[chosen]])


def _between(start: Vector64, rays: Points64, other_start: Vector64, other_rays: Points64) -> Points64:
    """Return the middle of the shortest line between two rays each; not finite where they are parallel."""
    gap = other_start - start
    cosine = (rays * other_rays).sum(axis=1)
    along, other_along = rays @ gap, other_rays @ gap
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = 1.0 / (1.0 - cosine**2)
        near = (along - cosine * other_along) * scale
        far = (cosine * along - other_along) * scale
        return np.asarray(0.5 * (start + near[:, None] * rays + other_start + far[:, None] * other_rays))
