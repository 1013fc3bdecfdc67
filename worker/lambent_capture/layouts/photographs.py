"""Reads photographs without cameras: what a phone or a camera leaves behind.

    <scene>/          pictures, at any depth; or
    <scene>/images/   pictures, and nothing else counts

Masks may be next to them, see `mask_search`.

Their cameras are found by the task `cameras` (`lambent_capture.poses`), which leaves a folder of its own:

    <cameras>/sparse/0/     COLMAP's model; names are paths below the folder of the pictures
    <cameras>/cameras.json  see `FoundCameras`

The pictures stay where they are.
"""

from collections.abc import Sequence
from pathlib import Path, PurePosixPath

from lambent_core.errors import WorkerError
from lambent_proto.v1 import scene_pb2
from pydantic import BaseModel, ConfigDict, ValidationError

from lambent_capture.layouts import colmap
from lambent_capture.layouts.picture_files import photographs_in, pictures_below
from lambent_capture.problems import Problems
from lambent_capture.scenes.capture import LIGHT, Capture, training_frame
from lambent_capture.scenes.frames import name_frames
from lambent_capture.scenes.links import leads_inside, link_out, note_links

NAME = "photographs"

IMAGES = "images"
CAMERAS_FILE = "cameras.json"


class FoundFinding(BaseModel):
    """Something to tell the owner about found cameras."""

    model_config = ConfigDict(extra="ignore", frozen=True)

    code: str
    message: str
    subject: str = ""


class FoundCameras(BaseModel):
    """What is written beside the model of found cameras."""

    model_config = ConfigDict(extra="ignore", frozen=True)

    inputs: str
    """Hash of the pictures, masks and settings that they were found from."""
    photographs: int
    """Pictures that were given."""
    missing: tuple[str, ...] = ()
    """Pictures whose cameras were not found, as paths below the folder of the pictures."""
    points: int = 0
    reprojection_error_px: float = 0.0
    """Mean distance of points from where they are seen, pixels of the pictures that were searched."""
    up: tuple[float, float, float] | None = None
    """Direction that points up in the model's world, unit length; None where nothing tells."""
    findings: tuple[FoundFinding, ...] = ()
    static_background: bool = False
    """Whether the background stood still while the object moved, as on a turntable."""

    @property
    def registered(self) -> int:
        """Return how many pictures have cameras."""
        return self.photographs - len(self.missing)


def is_layout(folder: Path) -> bool:
    """Return whether `folder` holds pictures."""
    return bool(pictures_below(folder))


def folder_of_pictures(folder: Path) -> Path:
    """Return the folder below which the pictures of a capture lie."""
    images = folder / IMAGES
    return images if images.is_dir() and leads_inside(images, folder) else folder


def read_capture(folder: Path, problems: Problems, cameras: Path | None = None) -> Capture:
    """Return the capture of the pictures in `folder`; all problems are added to `problems`.

    With `cameras`, the folder of found ones, its frames are the pictures that have one. Without, frames have
    no camera.
    """
    root = folder_of_pictures(folder)
    if link_out(folder, PurePosixPath(IMAGES)) is not None:
        note_links([folder / IMAGES], folder, problems, needed=True)
    prefix = root.relative_to(folder)
    names = [(prefix / name).as_posix() for name in photographs_in(root, problems, within=folder)]
    if cameras is not None:
        known = read_found_cameras(cameras)
        capture = colmap.read_model(folder, cameras, problems, pictures=prefix.as_posix())
        used = {image.path for frame in capture.frames for image in frame.images}
        capture.other_files |= set(names) - used
        capture.up = known.up
        return capture
    capture = Capture(name=folder.resolve().name, lights=[LIGHT], up_is_z=False, has_cameras=False)
    capture.frames = [training_frame(name) for name in names]
    name_frames(capture.frames)
    return capture


def read_found_cameras(folder: Path) -> FoundCameras:
    """Return what is known of the cameras in `folder`; raises `WorkerError` where that cannot be read."""
    try:
        return FoundCameras.model_validate_json((folder / CAMERAS_FILE).read_bytes())
    except (OSError, ValidationError) as error:
        raise WorkerError(
            "run.cameras_broken", f'"{folder / CAMERAS_FILE}" cannot be read ({error}); remove "{folder}"'
        ) from error


def lacks_cameras(frames: Sequence[scene_pb2.Frame]) -> bool:
    """Return whether the cameras of a manifest's frames are still to be found."""
    return any(not frame.HasField("camera") for frame in frames)
