"""Photographs that are decoded when they are needed, at the size that is needed, and forgotten again."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from lambent_core.errors import WorkerError
from lambent_proto.v1 import scene_pb2

from lambent_capture.arrays import Points64, Rgb
from lambent_capture.masks.consensus import MaskView
from lambent_capture.pictures.picture_error import PictureError
from lambent_capture.pictures.pictures import read_picture
from lambent_capture.pictures.resample import reduced_size
from lambent_capture.scenes.picture_camera import PictureCamera

Read = Callable[[int], Rgb]
"""Returns a photograph with its longer side at most as many pixels long, sRGB."""

Progress = Callable[[str, int, int], None]
"""Called with what is done at present, and how many of how many; may raise to stop the work."""


@dataclass(frozen=True, slots=True)
class Photograph:
    """A photograph that is not decoded yet, and the camera that took it."""

    name: str
    camera: PictureCamera
    """In pixels of the file."""
    read: Read

    def reduced(self, side: int) -> MaskView:
        """Return the photograph with its longer side at most `side` pixels, and the camera in its pixels."""
        size = reduced_size(self.camera.width, self.camera.height, side)
        pixels = self.read(side)
        if (pixels.shape[1], pixels.shape[0]) != size:
            pixels = np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA))
        return MaskView(self.name, pixels, self.camera.resized(*size))


@dataclass(frozen=True, kw_only=True, slots=True)
class SparsePoints:
    """Points that were found while cameras were solved, or with cameras that are known."""

    xyz: Points64
    """Scene units, in the coordinates of the cameras."""
    seen_by: tuple[tuple[int, ...], ...] = ()
    """For each point the views that see it, as positions in the list of views; empty where unknown."""


def photographs_of(folder: Path, manifest: scene_pb2.SceneManifest) -> list[Photograph]:
    """Return the photographs of a capture that have cameras; of several lights the first training light's."""
    return [
        Photograph(frame.name, PictureCamera.of_frame(frame), _file_reader(folder, frame, manifest))
        for frame in manifest.frames
        if frame.images
    ]


def _file_reader(folder: Path, frame: scene_pb2.Frame, manifest: scene_pb2.SceneManifest) -> Read:
    path = min(frame.images, key=lambda image: image.light not in manifest.lights).path

    def read(side: int) -> Rgb:
        try:
            return read_picture(folder / path, side=side).srgb()
        except PictureError as error:
            raise WorkerError(error.code, f"{path} {error}") from error

    return read
