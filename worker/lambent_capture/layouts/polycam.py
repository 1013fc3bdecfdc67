"""Reads the raw data that Polycam exports: a camera in a JSON file for every key frame.

    <scene>/keyframes/corrected_cameras/<time>.json  corrected_images/<time>.jpg     solved by Polycam
    <scene>/keyframes/cameras/<time>.json            images/<time>.jpg               tracked by the telephone
    <scene>/keyframes/depth/  confidence/                                            not used

A camera has `fx`, `fy`, `cx`, `cy` in pixels of a `width` x `height` picture and `t_00` to `t_23`, the rows
of camera-to-world with camera axes x right, y up, looking along -z; world y up (ARKit).
"""

from pathlib import Path, PurePosixPath
from typing import Any

from lambent_proto.v1 import scene_pb2

from lambent_capture.layouts.transforms_json import find_picture, read_camera
from lambent_capture.problems import Problems
from lambent_capture.scenes.capture import LIGHT, Capture, training_frame
from lambent_capture.scenes.frames import name_frames
from lambent_capture.scenes.links import leads_inside
from lambent_capture.scenes.reading import ROOT, read_json_object

NAME = "polycam"

KEY_FRAMES = ("keyframes", ".")
SETS = (("corrected_cameras", "corrected_images"), ("cameras", "images"))
"""Cameras and their photographs, the better ones first; the two are not mixed, since their worlds differ."""
LEAST_CAMERAS = 3
_LENS = {"fl_x": "fx", "fl_y": "fy", "cx": "cx", "cy": "cy", "w": "width", "h": "height"}
_POSE = [[f"t_{row}{column}" for column in range(4)] for row in range(3)]
_NEEDED = (*_LENS.values(), *(name for row in _POSE for name in row))


def is_layout(folder: Path) -> bool:
    """Return whether `folder` looks like this layout."""
    return _cameras_and_pictures(folder) is not None


def read_capture(folder: Path, problems: Problems, at: PurePosixPath = ROOT) -> Capture:
    """Return all usable frames of `folder`, whose key frames are below `at`; problems go to `problems`."""
    capture = Capture(name=folder.resolve().name, lights=[LIGHT], up_is_z=False, up=(0.0, 1.0, 0.0))
    places = _cameras_and_pictures(folder / at)
    if places is None:
        problems.error(
            "scene.file_missing",
            "there are no JSON files in keyframes/corrected_cameras or keyframes/cameras beside a folder of "
            "photographs; export Polycam's raw data again",
            "keyframes/cameras",
        )
        return capture
    cameras, pictures = (at / each for each in places)
    seen: set[str] = set()
    for name in _names(folder / cameras):
        path = (cameras / name).as_posix()
        values = read_json_object(folder, path, problems)
        if values is None:
            continue
        frame = _read_frame(folder, path, (pictures / name).with_suffix("").as_posix(), values, problems)
        if frame is not None and frame.images[0].path not in seen:
            seen.add(frame.images[0].path)
            capture.frames.append(frame)
    name_frames(capture.frames)
    return capture


def _cameras_and_pictures(folder: Path) -> tuple[PurePosixPath, PurePosixPath] | None:
    """Return where below `folder` the cameras and their photographs lie, or None where there are none."""
    for base in KEY_FRAMES:
        sets = [tuple(PurePosixPath(base) / each for each in pair) for pair in SETS]
        sets = [pair for pair in sets if all((folder / each).is_dir() for each in pair)]
        full = [pair for pair in sets if len(_names(folder / pair[0])) >= LEAST_CAMERAS]
        for cameras, pictures in full or sets:
            if any(_is_camera(folder / cameras / name, folder) for name in _names(folder / cameras)[:1]):
                return cameras, pictures
    return None


def _names(folder: Path) -> list[str]:
    try:
        return sorted(path.name for path in folder.iterdir() if path.suffix.lower() == ".json")
    except OSError:
        return []


def _is_camera(path: Path, folder: Path) -> bool:
    """Return whether a file looks like a camera of Polycam, which other programs' `cameras/` do not have."""
    if path.parents[1].name == KEY_FRAMES[0]:
        return True
    try:
        return leads_inside(path, folder) and b'"t_00"' in path.read_bytes()[:4096]
    except OSError:
        return False


def _read_frame(
    folder: Path, path: str, picture: str, values: dict[str, Any], problems: Problems
) -> scene_pb2.Frame | None:
    lacking = [key for key in _NEEDED if key not in values]
    if lacking:
        problems.error(
            "scene.camera_missing",
            f"{path} has no {', '.join(lacking[:4])}; export Polycam's raw data again, or remove the file",
            path,
        )
        return None
    photograph = find_picture(folder, picture, path, problems)
    if photograph is None:
        return None
    own = {key: values[name] for key, name in _LENS.items()}
    own["transform_matrix"] = [[values[name] for name in row] for row in _POSE]
    camera = read_camera(folder, photograph, {}, own, path, problems)
    if camera is None:
        return None
    return training_frame(photograph, camera)
