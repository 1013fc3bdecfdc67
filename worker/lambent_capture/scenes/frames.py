"""Checks common to all layouts: unique names, equal sizes, no unused pictures."""

from collections import Counter
from pathlib import Path, PurePosixPath

from lambent_proto.v1 import scene_pb2

from lambent_capture.pictures.pictures import PICTURE_SUFFIXES
from lambent_capture.problems import Problems

SHOWN = 5
"""Names listed in one message."""


def check_names(frames: list[scene_pb2.Frame], problems: Problems) -> None:
    """Note frames that share a name: predictions and reports could not tell them apart."""
    first: dict[str, str] = {}
    for frame in frames:
        path = frame.images[0].path
        if frame.name.casefold() in first:
            problems.error(
                "scene.frame_duplicate",
                f'{path} and {first[frame.name.casefold()]} both make a frame called "{frame.name}"; rename '
                "one of them",
                path,
            )
        first.setdefault(frame.name.casefold(), path)


def check_sizes(frames: list[scene_pb2.Frame], problems: Problems) -> None:
    """Note pictures that differ in size from most of `frames`, which are said to share one lens."""
    sizes = Counter((frame.camera.width, frame.camera.height) for frame in frames)
    if len(sizes) < 2:
        return
    (common, _), *_ = sizes.most_common(1)
    odd = [frame for frame in frames if (frame.camera.width, frame.camera.height) != common]
    camera = odd[0].camera
    problems.warning(
        "scene.image_sizes_mixed",
        f"{listed([frame.images[0].path for frame in odd])} ({camera.width} x {camera.height} pixels) differ "
        f"in size from the rest ({common[0]} x {common[1]}) although one lens is stated for all; that is "
        "right for pictures that were scaled and wrong for cropped ones",
        odd[0].images[0].path,
    )


def report_extra_files(
    folder: Path, frames: list[scene_pb2.Frame], known: set[str], problems: Problems
) -> None:
    """Note pictures that belong to no frame; `known` are those that belong to the layout all the same.

    Masks that are named like a picture in `known` belong to it.
    """
    used = {image.path for frame in frames for image in frame.images}
    used |= {path for frame in frames for path in frame.truth.values()}
    used |= {frame.mask for frame in frames if frame.mask}
    places = sorted({PurePosixPath(path).parent.as_posix() for path in used})
    extra = [
        path.relative_to(folder).as_posix()
        for place in places
        for path in sorted((folder / place).iterdir())
        if path.is_file() and path.suffix.lower() in PICTURE_SUFFIXES and not path.name.startswith(".")
    ]
    masks = {PurePosixPath(frame.mask).parent for frame in frames if frame.mask}
    stems = {_stem(path) for path in known}
    extra = [
        path
        for path in extra
        if path not in used
        and path not in known
        and not (PurePosixPath(path).parent in masks and _stem(path) in stems)
    ]
    if extra:
        problems.warning(
            "scene.extra_file",
            f"{listed(extra)}: no frame uses this; add a camera for it or remove it",
            extra[0],
        )


def _stem(path: str) -> str:
    """Return the name of a file without any of its suffixes: COLMAP's masks are called `0001.jpg.png`."""
    return PurePosixPath(path).name.split(".")[0]


def listed(names: list[str]) -> str:
    """Return a few of the names and how many more there are."""
    more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
    return ", ".join(names[:SHOWN]) + more


def name_frames(frames: list[scene_pb2.Frame]) -> dict[str, str]:
    """Name frames after their first pictures, as `frame_names` does, and return the names by picture."""
    names = frame_names([frame.images[0].path for frame in frames])
    for frame in frames:
        frame.name = names[frame.images[0].path]
    return names


def frame_names(paths: list[str]) -> dict[str, str]:
    """Return a name for each picture: its path without suffix and without the folders all of them share."""
    folders = [PurePosixPath(path).parent.parts for path in paths]
    shared = 0
    while folders and all(len(parts) > shared and parts[shared] == folders[0][shared] for parts in folders):
        shared += 1
    return {path: "_".join(PurePosixPath(path).with_suffix("").parts[shared:]) for path in paths}
