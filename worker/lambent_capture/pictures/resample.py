"""Brings pictures to another size and to a pinhole camera: averaging over areas, and undoing distortion.

Pictures are arrays [height, width, channels] of linear values; pixel centres lie at half-integer coordinates.
"""

import numpy as np
from jaxtyping import Bool, Float, Float32, Float64
from lambent_proto.v1 import scene_pb2
from numpy import ndarray
from scipy import sparse

from lambent_capture.arrays import Channels32
from lambent_capture.pictures.lens import seen_by_lens

ROWS_AT_ONCE = 256
FLAGGED_SHARE = 0.02
"""A pixel that is hot, or that a lossy encoder made bright, flags nothing."""
SUPERSAMPLING = 2
"""Maximum oversampling while distortion is removed."""


def reduced_size(width: int, height: int, max_side: int) -> tuple[int, int]:
    """Return the size in pixels after reducing the longer side to `max_side`; never larger than before."""
    longest = max(width, height)
    if longest <= max_side:
        return width, height
    return max(1, round(width * max_side / longest)), max(1, round(height * max_side / longest))


def area_weights(source: int, target: int) -> Float64[ndarray, "target source"]:
    """Return the matrix that averages `source` pixels in a row over the extents of `target` equal ones."""
    edges = np.linspace(0.0, source, target + 1)
    columns = np.arange(source)
    overlap = np.minimum(edges[1:, None], columns + 1.0) - np.maximum(edges[:-1, None], columns)
    return np.clip(overlap, 0.0, None) * (target / source)


def resampled(
    values: Channels32, camera: scene_pb2.Camera, size: tuple[int, int], *, by_last: bool = False
) -> Float32[ndarray, "rows columns channels"]:
    """Return a picture as the pinhole `camera` shows it, with `size` = (width, height) pixels.

    Each new pixel is the average over its area; where the camera states a lens, distortion is undone. With
    `by_last` all other channels are multiplied by the last one first.
    """
    if camera.HasField("lens"):
        work = [
            min(source, SUPERSAMPLING * target)
            for source, target in zip((camera.width, camera.height), size, strict=True)
        ]
        stored = tuple(
            round(values.shape[axis] * side / source)
            for axis, side, source in ((1, work[0], camera.width), (0, work[1], camera.height))
        )
        values = averaged(values, (stored[0], stored[1]), by_last=by_last)
        values = _straightened(values, camera, (work[0], work[1]))
        by_last = False
    return averaged(values, size, by_last=by_last)


def resampled_colour(
    values: Float32[ndarray, "height width 4"], camera: scene_pb2.Camera, size: tuple[int, int]
) -> Float32[ndarray, "rows columns 4"]:
    """Return `resampled` with three channels weighted by the fourth, which is coverage."""
    if (values.shape[1], values.shape[0]) == size and not camera.HasField("lens"):
        return values
    mean = resampled(values, camera, size, by_last=True)
    mean[..., :3] = np.where(mean[..., 3:] > 0.0, mean[..., :3] / np.maximum(mean[..., 3:], 1e-12), 0.0)
    return mean


def resampled_flags(
    flags: Bool[ndarray, "height width channels"],
    coverage: Float32[ndarray, "height width 1"],
    camera: scene_pb2.Camera,
    size: tuple[int, int],
) -> Bool[ndarray, "rows columns channels"]:
    """Return which new pixels have the flag in more than `FLAGGED_SHARE` of what covers them."""
    if (flags.shape[1], flags.shape[0]) == size and not camera.HasField("lens"):
        return flags
    values = np.concatenate([flags, coverage], axis=-1, dtype=np.float32)
    mean = resampled(values, camera, size, by_last=True)
    return mean[..., :-1] > FLAGGED_SHARE * mean[..., -1:]


def resampled_weighted(
    values: Float32[ndarray, "height width 1"],
    weight: Float32[ndarray, "height width 1"],
    camera: scene_pb2.Camera,
    size: tuple[int, int],
) -> Float32[ndarray, "rows columns 1"]:
    """Return `resampled` for one channel weighted by `weight`; zero where the weight is zero."""
    if (values.shape[1], values.shape[0]) == size and not camera.HasField("lens"):
        return values
    return resampled(values * weight, camera, size) / np.maximum(resampled(weight, camera, size), 1e-12)


def averaged(
    values: Channels32, size: tuple[int, int], *, by_last: bool = False
) -> Float32[ndarray, "rows columns channels"]:
    """Return a picture with `size` = (width, height) pixels, each the mean over its area.

    With `by_last` all other channels are multiplied by the last one first. Sums have double precision, over a
    band of the picture at a time: photographs may be too large for a second copy.
    """
    height, width, channels = values.shape
    if (width, height) == size:
        return _multiplied(values) if by_last else values
    rows = sparse.csr_array(area_weights(height, size[1]))
    columns = sparse.csr_array(area_weights(width, size[0]))
    result = np.empty((size[1], size[0], channels), dtype=np.float32)
    step = max(1, ROWS_AT_ONCE * size[1] // height)
    for start in range(0, size[1], step):
        weights = rows[start : start + step]
        first, last = int(weights.indices.min()), int(weights.indices.max()) + 1
        band = values[first:last].astype(np.float64)
        if by_last:
            band[..., :-1] *= band[..., -1:]
        shorter = weights[:, first:last] @ band.reshape(last - first, width * channels)
        across = shorter.reshape(-1, width, channels).transpose(1, 0, 2).reshape(width, -1)
        mean = (columns @ across).reshape(size[0], -1, channels)
        result[start : start + step] = mean.transpose(1, 0, 2)
    return result


def _multiplied(values: Channels32) -> Channels32:
    """Return a picture whose last channel has been multiplied into the others."""
    return np.concatenate([values[..., :-1] * values[..., -1:], values[..., -1:]], axis=-1)


def _straightened(
    values: Channels32, camera: scene_pb2.Camera, size: tuple[int, int]
) -> Float32[ndarray, "rows columns channels"]:
    """Return the pinhole's picture, `size` = (width, height), looked up between the lens' pixels."""
    width, height = size
    lens = camera.lens
    across = (np.arange(width) + 0.5) * camera.width / width
    result = np.empty((height, width, values.shape[2]), dtype=np.float32)
    for start in range(0, height, ROWS_AT_ONCE):
        rows = np.arange(start, min(start + ROWS_AT_ONCE, height)) + 0.5
        seen_x, seen_y = seen_by_lens(camera, across, rows * camera.height / height)
        columns = seen_x * values.shape[1] / lens.width - 0.5
        lines = seen_y * values.shape[0] / lens.height - 0.5
        result[start : start + len(rows)] = _bilinear(values, columns, lines)
    return result


def _bilinear(
    values: Channels32, columns: Float[ndarray, "rows count"], lines: Float[ndarray, "rows count"]
) -> Float32[ndarray, "rows count channels"]:
    height, width = values.shape[:2]
    columns, lines = np.clip(columns, 0.0, width - 1.0), np.clip(lines, 0.0, height - 1.0)
    left = np.minimum(columns.astype(np.int64), max(width - 2, 0))
    above = np.minimum(lines.astype(np.int64), max(height - 2, 0))
    right, below = np.minimum(left + 1, width - 1), np.minimum(above + 1, height - 1)
    across = (columns - left).astype(np.float32)[..., None]
    down = (lines - above).astype(np.float32)[..., None]
    upper = values[above, left] * (1.0 - across) + values[above, right] * across
    lower = values[below, left] * (1.0 - across) + values[below, right] * across
    return upper * (1.0 - down) + lower * down
