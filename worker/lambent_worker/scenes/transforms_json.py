"""Common parts of all transforms files: naming pictures, and lenses by angle or in pixels.

The figures of a lens may stand in the file or in a frame: `camera_angle_x`, or `fl_x` (`fl_y`, `cx`, `cy`) in
pixels of a picture of `w` x `h`; OpenCV's distortion `k1`, `k2`, `p1`, `p2`, `k3`, with `camera_model`
FULL_OPENCV also `k4`, `k5`, `k6`.
"""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from lambent_proto.v1 import scene_pb2

from lambent_worker.scenes.lens import LensFigures, camera_with_lens
from lambent_worker.scenes.picture_error import PictureError
from lambent_worker.scenes.pictures import PICTURE_SUFFIXES, picture_size
from lambent_worker.scenes.problems import Problems
from lambent_worker.scenes.reading import (
    finite_number,
    finite_numbers,
    focal_from_angle,
    inside_folder,
    pose_from_numbers,
)

LENS_KEYS = ("camera_angle_x", "fl_x", "w")
SAME_SHAPE = 0.01
"""Relative difference of two aspect ratios that rounding a size may cause."""

_PERSPECTIVE = (
    "",
    "PINHOLE",
    "SIMPLE_PINHOLE",
    "PERSPECTIVE",
    "SIMPLE_RADIAL",
    "RADIAL",
    "OPENCV",
    "FULL_OPENCV",
)
_DISTORTION = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")


def frame_entries(
    name: str, transforms: dict[str, Any], problems: Problems
) -> list[tuple[str, dict[str, Any]]]:
    """Return the entries of a transforms file that name a picture, each with how to call it in messages."""
    entries = transforms.get("frames")
    if not isinstance(entries, list):
        problems.error("scene.metadata_unreadable", f'{name} has no list called "frames"; add it', name)
        return []
    found = []
    for index, entry in enumerate(entries):
        subject = f"{name} frame {index}"
        if isinstance(entry, dict) and isinstance(entry.get("file_path"), str):
            found.append((f'{subject} ("{entry["file_path"][:100]}")', entry))
            continue
        problems.error(
            "scene.file_path_missing", f'{subject} has no "file_path"; name the picture it is about', subject
        )
    return found


def posed_entries(
    folder: Path, name: str, transforms: dict[str, Any], seen: set[str], problems: Problems
) -> Iterator[tuple[str, dict[str, Any], str, scene_pb2.Camera]]:
    """Yield how to call it in messages, entry, picture and camera of each frame that has the latter two.

    Pictures in `seen` are refused, those yielded are added to it.
    """
    for subject, entry in frame_entries(name, transforms, problems):
        picture = find_picture(folder, entry["file_path"], subject, problems)
        if picture is None:
            continue
        if picture in seen:
            problems.error(
                "scene.frame_duplicate",
                f"{subject}: {picture} is named by an earlier frame already; remove one of the two",
                picture,
            )
            continue
        seen.add(picture)
        camera = read_camera(folder, picture, {**transforms, **entry}, subject, problems)
        if camera is not None:
            yield subject, entry, picture, camera


def find_picture(folder: Path, file_path: str, subject: str, problems: Problems) -> str | None:
    """Return the path of the picture that `file_path` (with or without a suffix) names, or None."""
    clean = inside_folder(file_path, subject, problems)
    if clean is None:
        return None
    candidates = [clean.as_posix()] if clean.suffix.lower() in PICTURE_SUFFIXES else []
    candidates += [
        clean.as_posix() + form for suffix in PICTURE_SUFFIXES for form in (suffix, suffix.upper())
    ]
    for candidate in candidates:
        if (folder / candidate).is_file():
            return candidate
    problems.lost(
        "scene.file_missing",
        f"{subject}: there is no {candidates[0]} (nor another supported picture of this name); add it or "
        "remove the frame",
        clean.as_posix(),
    )
    return None


def read_camera(
    folder: Path, picture: str, settings: dict[str, Any], subject: str, problems: Problems
) -> scene_pb2.Camera | None:
    """Return the camera of a picture; `settings` are the file's, overridden by the frame's."""
    if "transform_matrix" not in settings:
        problems.error(
            "scene.camera_missing",
            f'{subject} has no camera; add "transform_matrix" or remove the frame',
            picture,
        )
        return None
    pose = pose_from_numbers(settings["transform_matrix"], subject, problems)
    try:
        size = picture_size(folder / picture)
    except PictureError as error:
        problems.lost(error.code, f"{subject}: {picture} {error}", picture)
        return None
    figures = _read_lens(settings, size, picture, subject, problems)
    if pose is None or figures is None:
        return None
    return camera_with_lens(figures, pose, subject, problems)


def scaled(
    figures: LensFigures, size: tuple[int, int], picture: str, subject: str, problems: Problems
) -> LensFigures | None:
    """Return a lens for a picture that was scaled to `size` pixels, or None after noting another shape."""
    across, down = size[0] / figures.width, size[1] / figures.height
    rounding = 1.0 / max(1, min(size))
    if abs(across / down - 1.0) > max(SAME_SHAPE, rounding):
        turned = size == (figures.height, figures.width)
        problems.error(
            "scene.image_size",
            f"{picture} has {size[0]} x {size[1]} pixels, {subject} says {figures.width} x {figures.height}; "
            + (
                "save the picture turned as its camera held it, without an EXIF orientation"
                if turned
                else "use the picture that the camera was solved for"
            ),
            picture,
        )
        return None
    return replace(
        figures,
        width=size[0],
        height=size[1],
        focal_x=figures.focal_x * across,
        focal_y=figures.focal_y * down,
        centre_x=figures.centre_x * across,
        centre_y=figures.centre_y * down,
    )


def _read_lens(
    settings: dict[str, Any], size: tuple[int, int], picture: str, subject: str, problems: Problems
) -> LensFigures | None:
    distortion = _read_distortion(settings, picture, subject, problems)
    if "fl_x" not in settings and "camera_angle_x" not in settings:
        problems.error(
            "scene.camera_missing", f'{subject} has no lens; add "camera_angle_x" or "fl_x"', subject
        )
        return None
    if distortion is None:
        return None
    width, height = size
    if "fl_x" not in settings:
        focal = focal_from_angle(settings["camera_angle_x"], width, subject, problems)
        return None if focal is None else LensFigures.centred(size, focal, distortion)
    fl_x = settings["fl_x"]
    sizes = finite_numbers(
        [settings.get("w", width), settings.get("h", height), fl_x, settings.get("fl_y", fl_x)], 4
    )
    if sizes is None or min(sizes) <= 0.0 or min(sizes[:2]) < 1.0:
        centre = None
    else:
        centre = finite_numbers([settings.get("cx", 0.5 * sizes[0]), settings.get("cy", 0.5 * sizes[1])], 2)
    if sizes is None or centre is None:
        problems.error(
            "scene.lens_invalid",
            f"{subject}: w, h, fl_x, fl_y must be positive numbers and cx, cy finite ones, in pixels",
            subject,
        )
        return None
    stated = LensFigures(
        width=round(sizes[0]),
        height=round(sizes[1]),
        focal_x=sizes[2],
        focal_y=sizes[3],
        centre_x=centre[0],
        centre_y=centre[1],
        distortion=distortion,
    )
    return scaled(stated, size, picture, subject, problems)


def _read_distortion(
    settings: dict[str, Any], picture: str, subject: str, problems: Problems
) -> tuple[float, ...] | None:
    """Return the coefficients in OpenCV's order, or None after noting a lens that is not understood."""
    model = str(settings.get("camera_model", "")).upper()
    if model not in _PERSPECTIVE or settings.get("is_fisheye"):
        problems.error(
            "scene.lens_unsupported",
            f"{subject} has the camera model {model[:40] if model not in _PERSPECTIVE else 'fisheye'}, which "
            "no pinhole can stand in for; undistort the photographs to a pinhole with the program that "
            "solved them",
            picture,
        )
        return None
    values = [finite_number(settings.get(key, 0.0)) for key in _DISTORTION]
    numbers = [value for value in values if value is not None]
    if len(numbers) < len(_DISTORTION):
        bad = next(key for key, value in zip(_DISTORTION, values, strict=True) if value is None)
        problems.error(
            "scene.lens_invalid",
            f"{subject}: the distortion coefficient {bad} is no finite number; write 0 where there is none",
            subject,
        )
        return None
    if any(numbers[5:]) and model != "FULL_OPENCV":
        problems.error(
            "scene.lens_unsupported",
            f"{subject} has k4, k5 or k6 without the camera model FULL_OPENCV; programs mean different "
            "things by them, so name the model or undistort the photographs",
            picture,
        )
        return None
    return tuple(numbers)
