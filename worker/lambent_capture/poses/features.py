"""Finds the points of a photograph that other photographs may show as well: SIFT, through OpenCV.

Positions are in *work pixels*: those of the stored picture, reduced so that its longer side has `max_side`.
The upper left corner of the picture is (0, 0), so the middle of the first pixel is (0.5, 0.5), as in COLMAP.
"""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float, Float32, UInt8
from numpy import ndarray
from PIL import Image

from lambent_capture.arrays import Grey8, Region
from lambent_capture.pictures.picture_error import undecodable
from lambent_capture.pictures.picture_statements import MIRRORED, orientation_of
from lambent_capture.pictures.pictures import (
    PILLOW_FORMATS,
    opened,
    picture_format,
    picture_size,
    read_picture,
)

SURVEY_SIDE = 800
"""Longer side at which photographs with masks are looked at outside of their masks, pixels."""
SURVEY_FEATURES = 2048
CONTRAST = 0.0133
"""Least contrast of a point, a third of OpenCV's own: dark and pale objects have few points above that."""
MARGIN = 0.05
"""Share of a mask's box that is kept around it, so that points at its edge have their surroundings."""
COVERED = 0.5
"""Coverage above which a pixel belongs to the object."""

Box = tuple[int, int, int, int]
"""Left, upper, right and lower limit in stored pixels."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Features:
    """Points of one photograph, the clearest first."""

    points: Float32[ndarray, "points 4"]
    """x and y [work pixels], size of the spot (sigma, work pixels), and its direction [radians]."""
    descriptors: UInt8[ndarray, "points 128"]
    """Square roots of the shares of the gradients' sum, times 512 (RootSIFT)."""

    def __len__(self) -> int:
        """Return the number of points."""
        return len(self.points)

    def save(self, path: Path) -> None:
        """Write the file whole or not at all."""
        partial = path.with_name(path.name + ".tmp")
        with partial.open("wb") as file:
            np.savez(file, points=self.points, descriptors=self.descriptors)
            file.flush()
            os.fsync(file.fileno())
        partial.replace(path)

    @classmethod
    def load(cls, path: Path) -> "Features":
        """Return what `save` wrote; raises `OSError` or `ValueError` for a file that is damaged."""
        with np.load(path, allow_pickle=False) as stored:
            return cls(points=stored["points"], descriptors=stored["descriptors"])


def find_features(path: Path, max_side: int, max_features: int, covered: Region | None = None) -> Features:
    """Return the clearest points of a picture, those on `covered` pixels only where that is given.

    With `covered` the picture is cropped to it before it is reduced to `max_side`, so that a small object
    gets as many points as a large one. Raises `PictureError` for a picture that cannot be read.
    """
    width, height = picture_size(path)
    box = (0, 0, width, height) if covered is None else covered_box(covered)
    if box is None:
        return Features(points=np.zeros((0, 4), np.float32), descriptors=np.zeros((0, 128), np.uint8))
    grey, scale = grey_picture(path, box, max_side)
    # A mask may leave out some of the points within its box.
    spots = _sift(grey, max_features if covered is None else 2 * max_features)
    across, down = (box[2] - box[0]) / grey.shape[1], (box[3] - box[1]) / grey.shape[0]
    stored = spots.points[:, :2] * [across, down] + [box[0], box[1]]
    kept = np.ones(len(stored), bool)
    if covered is not None:
        columns, rows = stored.astype(int).T
        kept = covered[rows.clip(0, height - 1), columns.clip(0, width - 1)]
    work = work_scale(width, height, max_side)
    points = np.column_stack([stored * work, spots.points[:, 2] * (work / scale), spots.points[:, 3]])
    return Features(
        points=points[kept][:max_features].astype(np.float32),
        descriptors=spots.descriptors[kept][:max_features],
    )


def work_scale(width: int, height: int, max_side: int) -> float:
    """Return the size of work pixels over that of stored ones; at most 1."""
    return min(1.0, max_side / max(width, height))


def covered_box(covered: Region) -> Box | None:
    """Return the box around the covered pixels with some margin, or None where there are none."""
    rows, columns = np.flatnonzero(covered.any(axis=1)), np.flatnonzero(covered.any(axis=0))
    if not len(rows):
        return None
    margin = int(MARGIN * max(rows[-1] - rows[0], columns[-1] - columns[0])) + 8
    height, width = covered.shape
    return (
        max(0, int(columns[0]) - margin),
        max(0, int(rows[0]) - margin),
        min(width, int(columns[-1]) + 1 + margin),
        min(height, int(rows[-1]) + 1 + margin),
    )


def grey_picture(path: Path, box: Box, max_side: int) -> tuple[Grey8, float]:
    """Return a part of a picture in grey, reduced to `max_side`, and how much it was reduced (at most 1).

    JPEG is decoded at half, a quarter or an eighth of its size where that is enough: 24 megapixels then take
    6 MB.
    """
    across, down = box[2] - box[0], box[3] - box[1]
    scale = work_scale(across, down, max_side)
    size = max(1, round(scale * across)), max(1, round(scale * down))
    with _grey(path, scale) as image:
        width, _ = picture_size(path)
        # A reduced JPEG has its last column from fewer pixels, so that its width is rounded up.
        reduced = 2.0 ** -np.round(np.log2(width / image.width))
        left, upper, right, lower = (float(reduced) * edge for edge in box)
        grey = image.resize(size, Image.Resampling.LANCZOS, box=(left, upper, right, lower))
    return np.asarray(grey), scale


def _grey(path: Path, scale: float) -> Image.Image:
    """Return a picture in grey; a JPEG at no less than `scale` of its size."""
    if path.suffix.lower() in PILLOW_FORMATS and picture_format(path) == "JPEG":
        with opened(path) as image:
            # Of colours only the brightness counts here, in which another profile changes little.
            image.draft("L", (max(1, int(scale * image.width)), max(1, int(scale * image.height))))
            mirrored = orientation_of(image) in MIRRORED
            grey = _decoded(image)
            return grey.transpose(Image.Transpose.FLIP_LEFT_RIGHT) if mirrored else grey
    picture = read_picture(path)
    if picture.is_linear:
        light = picture.linear()
        top = np.percentile(light[::4, ::4], 99.5)
        shown = np.round(255.0 * np.clip(light / max(top, 1e-9), 0.0, 1.0) ** (1.0 / 2.2)).astype(np.uint8)
    else:
        shown = picture.srgb()
    return Image.fromarray(shown).convert("L")


def _decoded(image: Image.Image) -> Image.Image:
    try:
        return image.convert("L")
    except Exception as error:
        raise undecodable(error) from error


def _sift(grey: Grey8, max_features: int) -> Features:
    """Return points in pixels of `grey`. Sources: Lowe 2004; Arandjelovic and Zisserman 2012 (RootSIFT)."""
    finder: Any = cv2.SIFT.create(
        nfeatures=max_features, contrastThreshold=CONTRAST, enable_precise_upscale=True
    )
    spots, gradients = finder.detectAndCompute(np.ascontiguousarray(grey), None)
    if gradients is None:
        return Features(points=np.zeros((0, 4), np.float32), descriptors=np.zeros((0, 128), np.uint8))
    order = np.argsort([-point.response for point in spots], kind="stable")
    points = np.array(
        [[p.pt[0] + 0.5, p.pt[1] + 0.5, 0.5 * p.size, np.radians(p.angle)] for p in spots], np.float32
    )
    return Features(points=points[order], descriptors=_rooted(gradients[order]))


def _rooted(gradients: Float[ndarray, "points 128"]) -> UInt8[ndarray, "points 128"]:
    shares = gradients / np.maximum(gradients.sum(axis=1, keepdims=True), 1e-6)
    return np.clip(np.round(512.0 * np.sqrt(shares)), 0, 255).astype(np.uint8)
