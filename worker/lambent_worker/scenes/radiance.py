"""Reads a frame's photographs as linear radiance with coverage, and no more of them than is needed.

Pictures are linear Rec. 709 with straight alpha.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import torch
from flashcache.color import linear_from_srgb
from jaxtyping import Bool, Float32, Shaped, UInt8
from lambent_proto.v1 import scene_pb2
from numpy import ndarray

from lambent_worker.errors import WorkerError
from lambent_worker.scenes.coverage import alpha_of
from lambent_worker.scenes.crop import Box
from lambent_worker.scenes.picture_error import PictureError
from lambent_worker.scenes.pictures import has_alpha, read_coverage, read_pixels

CLIPPED_LEVEL = 252
"""Encoded level of a channel from which on it may have been clipped; below 255 for the rounding of JPEG."""


def frame_mask(folder: Path, frame: scene_pb2.Frame) -> Float32[ndarray, "height width"] | None:
    """Return the coverage in a frame's mask file, or None where it has none. Raises `WorkerError`."""
    if not frame.mask:
        return None
    with _naming(frame.mask):
        return read_coverage(folder / frame.mask, frame.mask_encoding)


def alphas(folder: Path, frame: scene_pb2.Frame) -> Iterator[Float32[ndarray, "height width"]]:
    """Yield the alpha of the photographs that have one, one at a time. Raises `WorkerError`."""
    for image in frame.images:
        with _naming(image.path):
            found = alpha_of(folder / image.path) if has_alpha(folder / image.path) else None
        if found is not None:
            yield found


def linear_photograph(
    folder: Path,
    frame: scene_pb2.Frame,
    image: scene_pb2.Image,
    box: Box,
    mask: Float32[ndarray, "height width"] | None,
) -> tuple[Float32[ndarray, "rows columns 4"], Bool[ndarray, "rows columns 3"] | None]:
    """Return the part `box` of a photograph in the exposure of the first frame; only it becomes float.

    `mask` is that of the frame at the size of the file. The flags say which channels of the object are at the
    end of the scale; None where no pixel is, as in pictures of floats. Raises `WorkerError` for a file that
    cannot be read, and for a mask of another size.
    """
    pixels = stored_pixels(folder, image.path)
    if mask is not None and mask.shape != pixels.shape[:2]:
        raise WorkerError(
            "scene.mask_size",
            f"{frame.mask} has {mask.shape[1]} x {mask.shape[0]} pixels, {image.path} has "
            f"{pixels.shape[1]} x {pixels.shape[0]}; make them one size",
        )
    part = slice(box[1], box[3]), slice(box[0], box[2])
    rgba = _linear_rgba(pixels[part], image.encoding)
    rgba[..., :3] *= np.float32(frame.exposure or 1.0)
    if mask is not None:
        # The smaller of the two: a picture that was cut out with the same mask keeps its soft edges.
        rgba[..., 3] = np.minimum(rgba[..., 3], mask[part])
    return rgba, _clipped(pixels[part], rgba[..., 3:]) if image.encoding == "srgb" else None


def stored_pixels(folder: Path, path: str) -> Shaped[ndarray, "height width channels"]:
    """Return the pixels of a file of the capture as `read_pixels` does; raises `WorkerError` naming it."""
    with _naming(path):
        return read_pixels(folder / path)


def with_alpha(values: Float32[ndarray, "height width _"]) -> Float32[ndarray, "height width 4"]:
    """Return a picture with four channels, opaque where it had no alpha."""
    if values.shape[-1] == 4:
        return values
    return np.concatenate([values[..., :3], np.ones_like(values[..., :1])], axis=-1)


def _clipped(
    pixels: UInt8[ndarray, "height width channels"], coverage: Float32[ndarray, "height width 1"]
) -> Bool[ndarray, "height width 3"] | None:
    colour = pixels[..., :1] if pixels.shape[-1] <= 2 else pixels[..., :3]
    flags = (colour >= CLIPPED_LEVEL) & (coverage > 0.0)
    return np.broadcast_to(flags, (*flags.shape[:2], 3)) if flags.any() else None


def _linear_rgba(
    pixels: Shaped[ndarray, "height width channels"], encoding: str
) -> Float32[ndarray, "height width 4"]:
    height, width, channels = pixels.shape
    rgba = np.empty((height, width, 4), dtype=np.float32)
    colour = pixels[..., :1] if channels <= 2 else pixels[..., :3]  # grey, perhaps with alpha
    has_alpha_channel = channels in (2, 4)
    if not has_alpha_channel:
        rgba[..., 3] = 1.0
    if encoding == "srgb":
        rgba[..., :3] = linear_from_srgb(torch.arange(256) / 255.0).numpy()[colour]
        if has_alpha_channel:
            np.divide(pixels[..., -1], np.float32(255.0), out=rgba[..., 3])
    else:
        rgba[..., :3] = colour
        if has_alpha_channel:
            rgba[..., 3] = pixels[..., -1]
    return rgba


@contextmanager
def _naming(path: str) -> Iterator[None]:
    """Turn what is wrong with a picture into a `WorkerError` that says which file it is."""
    try:
        yield
    except PictureError as error:
        raise WorkerError(error.code, f"{path} {error}") from error
