"""Coverage of each picture by the object: mask files, alpha, and their combination."""

from pathlib import Path

import numpy as np
from jaxtyping import Float32
from lambent_proto.v1 import scene_pb2
from numpy import ndarray

from lambent_worker.scenes.pictures import has_alpha, read_coverage, read_pixels
from lambent_worker.scenes.resample import reduced_size, resampled


def has_coverage(folder: Path, frame: scene_pb2.Frame) -> bool:
    """Return whether a frame has a mask file, or photographs that may be transparent; reads headers only.

    Raises `PictureError` for a photograph that cannot be opened.
    """
    return bool(frame.mask) or has_alpha(folder / frame.images[0].path)


def frame_coverage(folder: Path, frame: scene_pb2.Frame) -> Float32[ndarray, "height width"] | None:
    """Return the object's coverage of each pixel of the first photograph, or None if it is not given.

    The size is that of the files, lens distortion included. Raises `PictureError`.
    """
    alpha = None
    if has_alpha(folder / frame.images[0].path):
        alpha = alpha_of(folder / frame.images[0].path)
    if not frame.mask:
        return alpha
    mask = read_coverage(folder / frame.mask, frame.mask_encoding)
    return mask if alpha is None or alpha.shape != mask.shape else np.minimum(alpha, mask)


def alpha_of(path: Path) -> Float32[ndarray, "height width"]:
    """Return the alpha of a picture that has one, from 0 to 1. Raises `PictureError`."""
    pixels = read_pixels(path)
    full = 255.0 if pixels.dtype == np.uint8 else 1.0
    return np.clip(pixels[..., -1].astype(np.float32) / np.float32(full), 0.0, 1.0)


def small_coverage(
    folder: Path, frame: scene_pb2.Frame, max_side: int
) -> Float32[ndarray, "rows columns"] | None:
    """Return `frame_coverage` as the frame's pinhole camera shows it, reduced to `max_side` pixels."""
    coverage = frame_coverage(folder, frame)
    if coverage is None:
        return None
    size = reduced_size(frame.camera.width, frame.camera.height, max_side)
    return resampled(coverage[..., None], frame.camera, size)[..., 0]
