"""Common parts of all transforms files: naming pictures, and cameras; for lenses see `transforms_lens`."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import Any

from lambent_proto.v1 import scene_pb2

from lambent_capture.layouts.named_files import find_picture_file, other_suffix, picture_names
from lambent_capture.layouts.transforms_lens import read_lens
from lambent_capture.pictures.lens import LensFigures, camera_with_lens
from lambent_capture.pictures.picture_error import PictureError
from lambent_capture.pictures.pictures import PICTURE_SUFFIXES, picture_size
from lambent_capture.problems import Problems
from lambent_capture.scenes.links import link_out
from lambent_capture.scenes.reading import ROOT, inside_folder, pose_from_numbers

SAME_SHAPE = 0.01
"""Relative difference of two aspect ratios that rounding a size may cause."""


def frame_entries(
    name: str, transforms: dict[str, Any], problems: Problems
) -> list[tuple[str, dict[str, Any]]]:
    """Return the entries of a transforms file that name a picture, each with how to call it in messages."""
    entries = transforms.get("frames")
    if not isinstance(entries, list):
        problems.error("scene.metadata_unreadable", f'{name} has no list called "frames"; add it', name)
        return []
    named = []
    for index, entry in enumerate(entries):
        subject = f"{name} frame {index}"
        if isinstance(entry, dict) and isinstance(entry.get("file_path"), str):
            named.append((f'{subject} ("{entry["file_path"][:100]}")', entry))
            continue
        problems.error(
            "scene.file_path_missing", f'{subject} has no "file_path"; name the picture it is about', subject
        )
    return named


def posed_entries(
    folder: Path,
    name: str,
    transforms: dict[str, Any],
    seen: set[str],
    problems: Problems,
    at: PurePosixPath = ROOT,
) -> Iterator[tuple[str, dict[str, Any], str, scene_pb2.Camera]]:
    """Yield how to call it in messages, entry, picture and camera of each frame that has the latter two.

    The file lies in the folder `at` of the capture. Pictures in `seen` are refused, those yielded are added.
    """
    for subject, entry in frame_entries(name, transforms, problems):
        picture = find_picture(folder, entry["file_path"], subject, problems, at)
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
        camera = read_camera(folder, picture, transforms, entry, subject, problems)
        if camera is not None:
            yield subject, entry, picture, camera


def find_picture(
    folder: Path, file_path: str, subject: str, problems: Problems, at: PurePosixPath = ROOT
) -> str | None:
    """Return the path of the picture that `file_path` names, seen from the folder `at`, or None.

    Where the folder `at` does not have it, the capture's own folder may.
    """
    clean = inside_folder(file_path, subject, problems, at)
    if clean is None:
        return None
    file = find_picture_file(folder, clean)
    if file is None and at.parts:
        above = inside_folder(file_path, subject, Problems())
        file = None if above is None else find_picture_file(folder, above)
    if file is not None:
        return file.as_posix()
    astray = next((each for each in picture_names(clean) if link_out(folder, each) is not None), None)
    if astray is not None:
        problems.lost("scene.file_linked", f"{subject}: {astray} lies behind a link out", astray.as_posix())
        return None
    other = other_suffix(folder, clean)
    if other is not None and other.suffix.lower() not in PICTURE_SUFFIXES:
        problems.lost(
            "scene.image_format",
            f"{subject}: {other} has a format that is not read; export it as PNG or JPEG",
            other.as_posix(),
        )
        return None
    problems.lost(
        "scene.file_missing",
        f"{subject}: there is no {picture_names(clean)[0]} (nor another supported picture of this name"
        f"{'' if other is None else f', but {other}: give the frame that name'}); add it or remove the frame",
        clean.as_posix(),
    )
    return None


def read_camera(
    folder: Path,
    picture: str,
    shared: Mapping[str, Any],
    own: Mapping[str, Any],
    subject: str,
    problems: Problems,
) -> scene_pb2.Camera | None:
    """Return the camera of a picture; `shared` are the settings of the file, `own` those of the frame."""
    matrix = own.get("transform_matrix", shared.get("transform_matrix"))
    if matrix is None:
        problems.error(
            "scene.camera_missing",
            f'{subject} has no camera; add "transform_matrix" or remove the frame',
            picture,
        )
        return None
    pose = pose_from_numbers(matrix, subject, problems)
    try:
        size = picture_size(folder / picture)
    except PictureError as error:
        problems.lost(error.code, f"{subject}: {picture} {error}", picture)
        return None
    stated = read_lens(shared, own, size, picture, subject, problems)
    figures = None if stated is None else scaled(stated, size, picture, subject, problems)
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
