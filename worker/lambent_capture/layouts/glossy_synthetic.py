"""Reads Glossy Synthetic (NeRO): numbered pictures, each with a camera and a depth picture.

    <scene>/ 0.png 0-depth.png 0-camera.pkl 1.png ...        or one folder above, or two
    <one folder above>/synthetic_split_128.pkl               (test names, training names)

A camera is a pickle of [world-to-camera 3x4 with OpenCV axes, K 3x3]; pickles are read by
`pickled_arrays`, which runs nothing. A pixel with a depth below 14.5 belongs to the object. World z up.
"""

import re
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64
from lambent_proto.v1 import scene_pb2
from numpy import ndarray

from lambent_capture.arrays import Rotation64
from lambent_capture.layouts.pickled_arrays import PickleRefusedError, read_pickled_data
from lambent_capture.pictures.lens import LensFigures, camera_with_lens
from lambent_capture.pictures.mask_levels import NERO_DEPTH
from lambent_capture.pictures.picture_error import PictureError
from lambent_capture.pictures.pictures import picture_size
from lambent_capture.problems import Problems
from lambent_capture.scenes.capture import LIGHT, Capture, training_frame
from lambent_capture.scenes.reading import pose_from_world_to_camera

NAME = "glossy_synthetic"

_CAMERA = re.compile(r"(\d+)-camera\.pkl$")
_SPLIT = re.compile(r"synthetic_split_\d+\.pkl$")


def is_layout(folder: Path) -> bool:
    """Return whether `folder` looks like this layout."""
    return bool(_object_folders(folder))


def own_files(folder: Path) -> set[Path]:
    """Return the pickles of a capture that are read; all others are suspect."""
    places = {folder, *_object_folders(folder)}
    places |= {place.parent for place in places if place != folder}
    return {
        path
        for place in places
        for path in place.iterdir()
        if _CAMERA.match(path.name) or _SPLIT.match(path.name)
    }


def read_capture(folder: Path, problems: Problems) -> Capture:
    """Return all usable frames of `folder`; all problems are added to `problems`."""
    capture = Capture(name=folder.resolve().name, lights=[LIGHT])
    places = _object_folders(folder)
    if not places:
        problems.error("scene.camera_missing", "there is no <number>-camera.pkl; add the cameras")
        return capture
    if len(places) > 1:
        several = ", ".join(place.relative_to(folder).as_posix() for place in places[:10])
        problems.error(
            "scene.object_ambiguous",
            f"the folder holds several objects ({several}); give the folder of one, with a "
            "copy of the split file",
        )
        return capture
    (place,) = places
    capture.name = place.resolve().name
    names = sorted(
        (match[1] for path in place.iterdir() if (match := _CAMERA.match(path.name))),
        key=lambda n: (int(n), n),
    )
    tested, trained = _read_split(folder, place, set(names), problems)
    for name in names:
        base = place.relative_to(folder).as_posix()
        base = "" if base == "." else f"{base}/"
        frame = _read_frame(folder, base, name, problems)
        if frame is None:
            continue
        frame.split = scene_pb2.SPLIT_TEST if name in tested else scene_pb2.SPLIT_TRAIN
        if trained and name not in tested | trained:
            problems.warning(
                "scene.extra_file",
                f"{base}{name}.png is in neither list of the split file; it is trained on",
                f"{base}{name}.png",
            )
        capture.frames.append(frame)
    return capture


def _object_folders(folder: Path) -> list[Path]:
    """Return the folders with cameras: this one, or those one or two levels below."""
    for pattern in ("*-camera.pkl", "*/*-camera.pkl", "*/*/*-camera.pkl"):
        folders = sorted({path.parent for path in folder.glob(pattern) if _CAMERA.match(path.name)})
        if folders:
            return folders
    return []


def _read_split(folder: Path, place: Path, names: set[str], problems: Problems) -> tuple[set[str], set[str]]:
    """Return the names of test and training frames; both empty where no split file is in the folder."""
    places = [place, *(parent for parent in place.parents if parent == folder or folder in parent.parents)]
    files = [path for parent in places for path in sorted(parent.iterdir()) if _SPLIT.match(path.name)]
    if not files:
        problems.warning(
            "scene.split_missing",
            "there is no synthetic_split_128.pkl in the folder, so every eighth picture is held out; copy "
            "the file into it to measure on the published test views",
        )
        return set(), set()
    subject = files[0].relative_to(folder).as_posix()
    value = _read_pickle(files[0], subject, problems)
    if value is None:
        return set(), set()
    lists = list(value) if isinstance(value, list | tuple) else []
    if len(lists) != 2 or not all(isinstance(part, list | tuple) for part in lists):
        problems.error(
            "scene.metadata_unreadable",
            f"{subject} must hold two lists of names, of test and of training pictures; copy it again",
            subject,
        )
        return set(), set()
    tested, trained = ({str(item) for item in part} for part in lists)
    twice = sorted(tested & trained)
    if twice or len(tested) != len(lists[0]) or len(trained) != len(lists[1]):
        problems.error(
            "scene.frame_duplicate",
            f"{subject} names a picture twice ({', '.join(twice[:5]) or 'within one list'}); it can only be "
            "one of test and training",
            subject,
        )
    absent = sorted((tested | trained) - names, key=lambda n: (len(n), n))
    if absent:
        problems.error(
            "scene.file_missing",
            f"{subject} names {len(absent)} pictures without camera ({', '.join(absent[:5])}); add "
            f"{absent[0]}-camera.pkl and {absent[0]}.png, or remove the split file",
            f"{absent[0]}-camera.pkl",
        )
    return tested, trained


def _read_frame(folder: Path, base: str, name: str, problems: Problems) -> scene_pb2.Frame | None:
    picture, depth, subject = f"{base}{name}.png", f"{base}{name}-depth.png", f"{base}{name}-camera.pkl"
    try:
        width, height = picture_size(folder / picture)
    except PictureError as error:
        problems.error(error.code, f'{picture} (frame "{name}") {error}', picture)
        return None
    value = _read_pickle(folder / subject, subject, problems)
    if value is None:
        return None
    matrices = _matrices(value)
    if matrices is None:
        problems.error(
            "scene.camera_invalid",
            f"{subject} must hold a 3 x 4 world-to-camera matrix and a 3 x 3 lens matrix, found "
            f"{_shapes(value)}; copy it again",
            subject,
        )
        return None
    outer, inner = matrices
    pose = pose_from_world_to_camera(outer, subject, problems)
    figures = LensFigures(
        width=width,
        height=height,
        focal_x=float(inner[0, 0]),
        focal_y=float(inner[1, 1]),
        centre_x=float(inner[0, 2]),
        centre_y=float(inner[1, 2]),
    )
    if pose is None or not _check_middle(figures, picture, subject, problems):
        return None
    camera = camera_with_lens(figures, pose, subject, problems)
    if camera is None:
        return None
    frame = training_frame(picture, camera)
    frame.name = name
    if (folder / depth).is_file():
        frame.mask, frame.mask_encoding = depth, NERO_DEPTH
    return frame


def _check_middle(figures: LensFigures, picture: str, subject: str, problems: Problems) -> bool:
    """Return whether the optical axis is near the centre: only then can a wrong size be detected."""
    off = (
        abs(figures.centre_x - 0.5 * figures.width) / figures.width,
        abs(figures.centre_y - 0.5 * figures.height) / figures.height,
    )
    if not max(off) > 0.05:  # not "<=": NaN is left to the check of the lens
        return True
    problems.error(
        "scene.image_size",
        f"{picture} has {figures.width} x {figures.height} pixels, but {subject} was made for about "
        f"{2.0 * figures.centre_x:.0f} x {2.0 * figures.centre_y:.0f}; use the picture of that size",
        picture,
    )
    return False


def _read_pickle(path: Path, subject: str, problems: Problems) -> Any:
    try:
        return read_pickled_data(path)
    except (PickleRefusedError, OSError) as error:
        problems.error(
            "scene.pickle_refused",
            f"{subject} {error if isinstance(error, PickleRefusedError) else 'cannot be read'}; only numbers "
            "and arrays are read from pickles, nothing is run; copy the file of the data set again",
            subject,
        )
        return None


def _matrices(value: Any) -> tuple[Float64[ndarray, "3 4"], Rotation64] | None:
    if not isinstance(value, list | tuple) or len(value) != 2:
        return None
    if not all(isinstance(part, np.ndarray) for part in value):
        return None
    outer, inner = (np.asarray(part, dtype=np.float64) for part in value)
    if outer.shape not in ((3, 4), (4, 4)) or inner.shape != (3, 3):
        return None
    return outer[:3], inner


def _shapes(value: Any) -> str:
    parts = value if isinstance(value, list | tuple) else [value]
    return " and ".join(
        " x ".join(map(str, part.shape)) if isinstance(part, np.ndarray) else type(part).__name__
        for part in parts[:4]
    )
