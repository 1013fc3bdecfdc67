"""Cuts a frame's pictures and its camera to the object, so that resolution is spent where the object is.

Boxes are (left, top, right, bottom) in pixels, right and bottom exclusive.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool
from lambent_proto.v1 import scene_pb2
from numpy import ndarray

from lambent_capture.arrays import Grey32, Region
from lambent_capture.pictures.lens import seen_by_lens

Box = tuple[int, int, int, int]

MARGIN = 0.04
"""Room left around the object on every side, as a share of the longer side of its box."""
LEAST_SIDE = 16
"""A crop is not smaller than this unless the frame is, pixels: scores look at windows of 11 pixels."""
LEAST_ASPECT = 0.5
"""Shorter side of a crop over the longer one, at least, where the frame has that much to show."""
COVERED = 0.1
"""Coverage from which on a pixel belongs to the box: less is noise of a lossy mask, or lies in the margin."""
LENS_SIDE = 1024
"""Longer side at which coverage is straightened to find the box, pixels."""
_EDGE = 4
"""Pixels of the lens's picture around what a crop looks up: interpolation reads the neighbours too."""
_EDGE_SHARE = 0.04
"""The same as a share of the crop."""
_SAMPLES = 65
"""Points along each side of a crop whose places in the lens's picture are looked up."""


@dataclass(frozen=True, slots=True)
class Crop:
    """The part of a frame that is loaded."""

    camera: scene_pb2.Camera
    """The frame's camera with the crop for its picture, lens included."""
    pinhole: Box
    """The crop in pixels of the frame's pinhole camera."""
    file: Box
    """The part of the picture files that it is made of, in their pixels."""


def whole_frame(camera: scene_pb2.Camera) -> Crop:
    """Return the crop that is all of the frame."""
    stored = camera.lens if camera.HasField("lens") else camera
    return Crop(camera, (0, 0, camera.width, camera.height), (0, 0, stored.width, stored.height))


def object_crop(camera: scene_pb2.Camera, coverages: Iterable[Grey32]) -> Crop:
    """Return the crop to what any of `coverages` covers, with a margin; all of the frame where none does.

    They have the size of the files, and are looked at one after the other.
    """
    box: Box | None = None
    for coverage in coverages:
        own = covered_box(coverage, camera)
        if own is not None:
            box = own if box is None else _union(box, own)
    return whole_frame(camera) if box is None else cropped(camera, with_margin(box, camera))


def covered_box(coverage: Grey32, camera: scene_pb2.Camera) -> Box | None:
    """Return the box around covered pixels as the frame's pinhole camera shows them, or None without any.

    `coverage` has the size of the files. Through a lens the box may be too large by two pixels of a picture
    of `LENS_SIDE`.
    """
    covered = coverage >= COVERED
    columns, rows = _extent(np.any(covered, axis=0)), _extent(np.any(covered, axis=1))
    if columns is None or rows is None:
        return None
    if camera.HasField("lens"):
        return _straight_box(covered, camera)
    return columns[0], rows[0], columns[1], rows[1]


def with_margin(box: Box, camera: scene_pb2.Camera) -> Box:
    """Return the box with `MARGIN` around it, neither tiny nor very narrow, inside the frame."""
    longer = max(box[2] - box[0], box[3] - box[1])
    margin = int(np.ceil(MARGIN * longer))
    least = max(LEAST_SIDE, round(LEAST_ASPECT * longer))
    left, right = _widened(box[0] - margin, box[2] + margin, least, camera.width)
    top, bottom = _widened(box[1] - margin, box[3] + margin, least, camera.height)
    return left, top, right, bottom


def cropped(camera: scene_pb2.Camera, box: Box) -> Crop:
    """Return the crop of a frame to `box` of its pinhole's picture.

    The principal point moves, and nothing else does. Of a lens's picture that part is kept which the crop
    looks up, so that undoing the distortion gives the same values as in the whole frame.
    """
    left, top, right, bottom = box
    if box == (0, 0, camera.width, camera.height):
        return whole_frame(camera)
    result = scene_pb2.Camera()
    result.CopyFrom(camera)
    result.width, result.height = right - left, bottom - top
    result.centre_x, result.centre_y = camera.centre_x - left, camera.centre_y - top
    if not camera.HasField("lens"):
        return Crop(result, box, box)
    stored = _looked_up(result)
    result.lens.width, result.lens.height = stored[2] - stored[0], stored[3] - stored[1]
    result.lens.centre_x = camera.lens.centre_x - stored[0]
    result.lens.centre_y = camera.lens.centre_y - stored[1]
    return Crop(result, box, stored)


def _looked_up(camera: scene_pb2.Camera) -> Box:
    """Return the part of the lens's picture that `camera` looks up; its lens is still that of the file."""
    lens = camera.lens
    sides = (np.linspace(0.0, side, _SAMPLES) for side in (camera.width, camera.height))
    columns, rows = seen_by_lens(camera, *sides)
    # Pictures are reduced before they are straightened; the edge has to hold in reduced pixels too.
    edge_x, edge_y = (_EDGE + _EDGE_SHARE * float(np.ptp(places)) for places in (columns, rows))
    return (
        max(0, int(np.floor(columns.min() - edge_x))),
        max(0, int(np.floor(rows.min() - edge_y))),
        min(lens.width, int(np.ceil(columns.max() + edge_x))),
        min(lens.height, int(np.ceil(rows.max() + edge_y))),
    )


def _straight_box(covered: Region, camera: scene_pb2.Camera) -> Box | None:
    """Return the box of a lens's covered pixels in the pinhole's picture, to one block of pixels."""
    block = -(-max(covered.shape) // LENS_SIDE)
    blocks = np.logical_or.reduceat(covered, np.arange(0, covered.shape[0], block), axis=0)
    blocks = np.logical_or.reduceat(blocks, np.arange(0, covered.shape[1], block), axis=1)
    sides = (np.arange(0.5 * block, side, block) for side in (camera.width, camera.height))
    column, row = ((seen / block).astype(int) for seen in seen_by_lens(camera, *sides))
    straight = blocks[row.clip(0, blocks.shape[0] - 1), column.clip(0, blocks.shape[1] - 1)]
    columns, rows = _extent(straight.any(axis=0)), _extent(straight.any(axis=1))
    if columns is None or rows is None:
        return None
    return (
        block * max(0, columns[0] - 1),
        block * max(0, rows[0] - 1),
        min(block * (columns[1] + 1), camera.width),
        min(block * (rows[1] + 1), camera.height),
    )


def _extent(covered: Bool[ndarray, " count"]) -> tuple[int, int] | None:
    """Return the first position that is true and the one after the last, or None."""
    places = np.flatnonzero(covered)
    return (int(places[0]), int(places[-1]) + 1) if len(places) else None


def _widened(low: int, high: int, least: int, size: int) -> tuple[int, int]:
    """Return the interval cut to 0..`size`, with at least `least` pixels if there are so many."""
    low, high = max(0, low), min(size, high)
    wanted = max(high - low, min(least, size))
    low = min(max(0, low - (wanted - (high - low)) // 2), size - wanted)
    return low, low + wanted


def _union(one: Box, other: Box) -> Box:
    return (
        min(one[0], other[0]),
        min(one[1], other[1]),
        max(one[2], other[2]),
        max(one[3], other[3]),
    )
