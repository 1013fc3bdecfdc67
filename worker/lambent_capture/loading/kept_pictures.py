"""Keeps reduced photographs in a folder, by what they were made of, so that a run decodes each once."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
from jaxtyping import Bool, Float32
from lambent_core.files import digest, file_sha256, whole_file
from lambent_proto.v1 import scene_pb2
from numpy import ndarray

from lambent_capture.scenes.crop import Box

VERSION = 2
"""Changes whenever the same files would be loaded as other pictures."""
MOST_PIXELS = 512 * 512
"""Larger pictures are not kept: decoding them again costs less than the disk they would take."""
LEAST_REDUCTION = 8
"""Nor are pictures kept with more than one in so many pixels of their frame: decoding them is quick."""


@dataclass(frozen=True, slots=True, eq=False)
class Pictures:
    """The photographs of one frame as they are in memory."""

    box: Box
    """The part of the frame that they show, pixels of its pinhole camera."""
    images: Mapping[str, Float32[ndarray, "height width 4"]]
    clipped: Mapping[str, Bool[ndarray, "height width 3"]]


def kept(
    store: Path,
    folder: Path,
    frame: scene_pb2.Frame,
    settings: Mapping[str, object],
    make: Callable[[], Pictures],
) -> Pictures:
    """Return what `make` returns for a frame of the capture in `folder`, from `store` where that has it.

    `settings` is everything else that the result depends on. A damaged file of the store is made anew.
    """
    try:
        path = store / f"{_key(folder, frame, settings)}.npz"
    except OSError:  # a file is missing or cannot be read: loading it says which, and what to do
        return make()
    pictures = _read(path)
    if pictures is None:
        pictures = make()
        sizes = [image.shape[0] * image.shape[1] for image in pictures.images.values()]
        frame_pixels = frame.camera.width * frame.camera.height
        if max(sizes, default=0) <= min(MOST_PIXELS, frame_pixels // LEAST_REDUCTION):
            _write(path, pictures)
    return pictures


def _key(folder: Path, frame: scene_pb2.Frame, settings: Mapping[str, object]) -> str:
    """Return a hash of the contents of the files, of the camera, and of what else the pictures depend on."""
    files = [[image.light, image.encoding, file_sha256(folder / image.path)] for image in frame.images]
    mask = [frame.mask_encoding, file_sha256(folder / frame.mask)] if frame.mask else []
    camera = frame.camera.SerializeToString(deterministic=True).hex()
    return digest(VERSION, files, mask, camera, frame.exposure, dict(settings))


def _read(path: Path) -> Pictures | None:
    if not path.is_file():
        return None
    try:
        with np.load(path, allow_pickle=False) as arrays:
            stored = {name: arrays[name] for name in arrays.files}
        left, top, right, bottom = (int(value) for value in stored.pop("box"))
    except (BadZipFile, EOFError, KeyError, OSError, ValueError):
        return None
    parts: dict[str, dict[str, ndarray]] = {"images": {}, "clipped": {}}
    for name, values in stored.items():
        kind, _, light = name.partition("/")
        parts[kind][light] = values
    return Pictures((left, top, right, bottom), parts["images"], parts["clipped"])


def _write(path: Path, pictures: Pictures) -> None:
    """Write the file whole or not at all."""
    arrays = {"box": np.array(pictures.box)}
    arrays |= {f"images/{light}": values for light, values in pictures.images.items()}
    arrays |= {f"clipped/{light}": values for light, values in pictures.clipped.items()}
    with whole_file(path) as partial, partial.open("wb") as file:
        np.savez(file, allow_pickle=False, **arrays)
