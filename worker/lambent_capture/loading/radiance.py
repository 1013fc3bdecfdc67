"""Reads a frame's photographs as linear radiance with coverage, and no more of them than is needed.

Pictures are linear Rec. 709 with straight alpha.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float32
from lambent_core.errors import WorkerError
from lambent_proto.v1 import scene_pb2
from numpy import ndarray

from lambent_capture.arrays import Grey32, Levels
from lambent_capture.pictures import coverage
from lambent_capture.pictures.picture import Part, Picture
from lambent_capture.pictures.picture_error import PictureError
from lambent_capture.pictures.pictures import read_levels, read_picture
from lambent_capture.scenes.crop import Box


def mask_coverage(folder: Path, frame: scene_pb2.Frame) -> Grey32 | None:
    """Return the coverage in a frame's mask file, or None where it has none. Raises `WorkerError`."""
    with _naming(frame.mask):
        mask = coverage.frame_mask(folder, frame)
    return None if mask is None else mask.coverage


def alphas(folder: Path, frame: scene_pb2.Frame) -> Iterator[Grey32]:
    """Yield the alpha of the photographs that have one, one at a time. Raises `WorkerError`."""
    for image in frame.images:
        with _naming(image.path):
            alpha = coverage.alpha_of(folder / image.path)
        if alpha is not None:
            yield alpha


def linear_photograph(
    folder: Path, frame: scene_pb2.Frame, image: scene_pb2.Image, box: Box, mask: Grey32 | None
) -> tuple[Float32[ndarray, "rows columns 4"], Bool[ndarray, "rows columns 3"] | None]:
    """Return the part `box` of a photograph in the exposure of the first frame; only it becomes float.

    `mask` is that of the frame at the size of the file. The flags say which channels of the object are at the
    end of the scale; None where no pixel is, as in pictures of floats. Raises `WorkerError` for a file that
    cannot be read, and for a mask of another size.
    """
    with _naming(image.path):
        picture = read_picture(folder / image.path)
    width, height = picture.size
    if mask is not None and mask.shape != (height, width):
        raise WorkerError(
            "scene.mask_size",
            f"{frame.mask} has {mask.shape[1]} x {mask.shape[0]} pixels, {image.path} has "
            f"{width} x {height}; make them one size",
        )
    part = slice(box[1], box[3]), slice(box[0], box[2])
    rgba = np.dstack([picture.linear(part), picture.coverage(part)])
    rgba[..., :3] *= np.float32(frame.exposure or 1.0)
    if mask is not None:
        # The smaller of the two: a picture that was cut out with the same mask keeps its soft edges.
        rgba[..., 3] = np.minimum(rgba[..., 3], mask[part])
    return rgba, _clipped(picture, part, rgba[..., 3:])


def stored_levels(folder: Path, path: str) -> Levels:
    """Return the numbers in a file of the capture as `read_levels` does; raises `WorkerError` naming it."""
    with _naming(path):
        return read_levels(folder / path)


def with_alpha(values: Float32[ndarray, "height width _"]) -> Float32[ndarray, "height width 4"]:
    """Return a picture with four channels, opaque where it had no alpha."""
    if values.shape[-1] == 4:
        return values
    return np.concatenate([values[..., :3], np.ones_like(values[..., :1])], axis=-1)


def _clipped(
    picture: Picture, part: Part, covered: Float32[ndarray, "height width 1"]
) -> Bool[ndarray, "height width 3"] | None:
    ended = picture.clipped(part)
    if ended is None:
        return None
    flags = ended & (covered > 0.0)
    return np.broadcast_to(flags, (*flags.shape[:2], 3)) if flags.any() else None


@contextmanager
def _naming(path: str) -> Iterator[None]:
    """Turn what is wrong with a picture into a `WorkerError` that says which file it is."""
    try:
        yield
    except PictureError as error:
        raise WorkerError(error.code, f"{path} {error}") from error
