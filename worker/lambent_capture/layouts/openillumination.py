"""Reads OpenIllumination: every camera photographed under several numbered light patterns.

    <object>/Lights/<light>/raw_undistorted/<camera>.JPG
    <object>/output/transforms_train.json, transforms_test.json (or transforms_val.json)
    <object>/output/com_masks/<camera>.png    object and stand, for training
    <object>/output/obj_masks/<camera>.png    object alone, for test views
    or lighting_patterns/<object>/..., with one object

Frames are named by camera; poses are camera-to-world with OpenCV axes (x right, y down, z forward).
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from lambent_proto.v1 import scene_pb2

from lambent_capture.pictures.lens import LensFigures, camera_with_lens
from lambent_capture.pictures.picture_error import PictureError
from lambent_capture.pictures.pictures import PILLOW_FORMATS, encoding_of, picture_size
from lambent_capture.problems import Problems
from lambent_capture.scenes.capture import Capture
from lambent_capture.scenes.exposure import stated_exposure
from lambent_capture.scenes.reading import (
    OPENGL_FROM_OPENCV,
    finite_number,
    focal_from_angle,
    inside_folder,
    pose_from_numbers,
    read_json_object,
)

NAME = "openillumination"
PAPER_LIGHTS = ("013", "011", "009")
"""The light of single-light training first, then those that multi-light training adds."""

_TRAIN = "output/transforms_train.json"
_TESTS = ("output/transforms_test.json", "output/transforms_val.json")


def is_layout(folder: Path) -> bool:
    """Return whether `folder` looks like this layout."""
    return bool(_object_folders(folder))


def read_capture(folder: Path, problems: Problems) -> Capture:
    """Return all usable frames of `folder`; all problems are added to `problems`."""
    capture = Capture(name=folder.resolve().name)
    places = _object_folders(folder)
    if len(places) != 1:
        names = ", ".join(place.relative_to(folder).as_posix() for place in places[:10])
        problems.error(
            "scene.object_ambiguous",
            f"the folder holds several objects ({names}); give the folder of one"
            if places
            else f"there is no {_TRAIN} beside a folder Lights; add it",
        )
        return capture
    place = places[0].relative_to(folder).as_posix()
    base = "" if place == "." else f"{place}/"
    capture.name = places[0].resolve().name
    lights = {path.name for path in (places[0] / "Lights").iterdir() if (path / "raw_undistorted").is_dir()}
    capture.lights = [light for light in PAPER_LIGHTS if light in lights]
    capture.lights += sorted(lights - set(capture.lights))
    # Whatever is not trained on is relit to; see lights.select_lights.
    capture.relight_lights = list(capture.lights)
    seen: set[str] = set()
    for name, split, masks in _splits(folder, base):
        for camera, subject, settings in _entries(folder, base + name, seen, problems):
            frame = _read_frame(folder, base, camera, settings, capture.lights, subject, problems)
            if frame is None:
                continue
            frame.split = split
            frame.mask = f"{base}output/{masks}/{camera}.png"
            if not (folder / frame.mask).is_file():
                problems.error(
                    "scene.file_missing",
                    f"{subject} has no mask {frame.mask}; copy it from the data set again",
                    frame.mask,
                )
                continue
            exposure = stated_exposure(settings)
            if exposure is not None:
                capture.exposures[camera] = exposure
            capture.frames.append(frame)
    # Both kinds of masks belong to every camera; only one of them is used.
    capture.other_files |= {
        f"{base}output/{kind}/{name}.png" for name in seen for kind in ("com_masks", "obj_masks")
    }
    return capture


def _splits(folder: Path, base: str) -> Iterator[tuple[str, scene_pb2.Split, str]]:
    """Yield the files of cameras with their split and the folder of their masks."""
    yield _TRAIN, scene_pb2.SPLIT_TRAIN, "com_masks"
    tested = [name for name in _TESTS if (folder / base / name).is_file()]
    yield from ((name, scene_pb2.SPLIT_TEST, "obj_masks") for name in tested[:1])


def _entries(
    folder: Path, name: str, seen: set[str], problems: Problems
) -> Iterator[tuple[str, str, dict[str, Any]]]:
    """Yield each camera of a file that is not in `seen`, how to call it in messages, and its settings."""
    transforms = read_json_object(folder, name, problems)
    if transforms is None:
        return
    frames = transforms.get("frames")
    if not isinstance(frames, dict):
        problems.error(
            "scene.metadata_unreadable",
            f'{name} has no "frames" by camera name; copy it from the data set again',
            name,
        )
        return
    for camera, entry in sorted(frames.items()):
        subject = f'{name} frame "{camera[:100]}"'
        if camera in seen:
            problems.error(
                "scene.frame_duplicate",
                f"{subject} is in the other split already; it can only be in one",
                camera,
            )
            continue
        seen.add(camera)
        yield camera, subject, {**transforms, **entry} if isinstance(entry, dict) else {}


def _object_folders(folder: Path) -> list[Path]:
    for pattern in ("Lights", "*/Lights", "lighting_patterns/*/Lights"):
        folders = sorted(path.parent for path in folder.glob(pattern) if (path.parent / _TRAIN).is_file())
        if folders:
            return folders
    return []


def _read_frame(
    folder: Path,
    base: str,
    camera: str,
    settings: dict[str, Any],
    lights: list[str],
    subject: str,
    problems: Problems,
) -> scene_pb2.Frame | None:
    if inside_folder(camera, subject, problems) is None:
        return None
    frame = scene_pb2.Frame(name=camera)
    size: tuple[int, int] | None = None
    for light in lights:
        path = _find_photograph(folder, f"{base}Lights/{light}/raw_undistorted/{camera}")
        if path is None:
            missing = f"{base}Lights/{light}/raw_undistorted/{camera}.JPG"
            problems.error(
                "scene.file_missing",
                f"{subject} has no photograph {missing}, though there are others under this light; add it or "
                "remove the light",
                missing,
            )
            continue
        try:
            own_size = picture_size(folder / path)
        except PictureError as error:
            problems.error(error.code, f"{subject}: {path} {error}", path)
            continue
        if size is not None and own_size != size:
            problems.error(
                "scene.image_size",
                f"{path} has {own_size[0]} x {own_size[1]} pixels, the camera's other photographs have "
                f"{size[0]} x {size[1]}; use one size",
                path,
            )
            continue
        size = own_size
        frame.images.append(scene_pb2.Image(light=light, path=path, encoding=encoding_of(path)))
    if "transform_matrix" not in settings:
        problems.error(
            "scene.camera_missing",
            f'{subject} has no camera; add "transform_matrix" or remove the frame',
            camera,
        )
        return None
    pose = pose_from_numbers(settings["transform_matrix"], subject, problems)
    if size is None or len(frame.images) < len(lights):
        return None
    focal = focal_from_angle(settings.get("camera_angle_x"), size[0], subject, problems)
    if pose is None or focal is None or not _check_width(settings, size, subject, camera, problems):
        return None
    figures = LensFigures.centred(size, focal)
    described = camera_with_lens(figures, pose @ OPENGL_FROM_OPENCV, subject, problems)
    if described is None:
        return None
    frame.camera.CopyFrom(described)
    return frame


def _find_photograph(folder: Path, stem: str) -> str | None:
    suffixes = [form for suffix in PILLOW_FORMATS for form in (suffix, suffix.upper())]
    return next((stem + suffix for suffix in suffixes if (folder / (stem + suffix)).is_file()), None)


def _check_width(
    settings: dict[str, Any], size: tuple[int, int], subject: str, camera: str, problems: Problems
) -> bool:
    """Return whether the pictures are upright, and as wide as those the cameras were solved for or a part."""
    if "calib_imgw" not in settings:
        return True
    stated = finite_number(settings["calib_imgw"])
    if stated is None or stated < 1.0:
        problems.error(
            "scene.lens_invalid",
            f"{subject}: calib_imgw must be the width of the calibrated picture in pixels, found "
            f"{str(settings['calib_imgw'])[:40]}",
            subject,
        )
        return False
    share = size[0] / stated
    if abs(share * round(1.0 / share) - 1.0) > 0.02 if share <= 1.0 else share > 1.02:
        problems.error(
            "scene.image_size",
            f"{subject}: its photographs are {size[0]} pixels wide, the cameras were solved for {stated:g}; "
            "use the original photographs, upright, or reduce them by a whole factor",
            camera,
        )
        return False
    return True
