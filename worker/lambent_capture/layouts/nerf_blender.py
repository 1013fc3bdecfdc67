"""Reads the NeRF-Blender layout: `transforms_{train,test,val}.json` next to the pictures they name.

Each frame has `file_path` (with or without a suffix) and `transform_matrix`, camera-to-world with camera axes
x right, y up, looking along -z. The lens is `camera_angle_x`, or `fl_x` (`fl_y`, `cx`, `cy`), for the file or
per frame, see `transforms_lens`. Ground truth, where it exists, is next to a picture as `<stem>_albedo.png`
and so on.
"""

from collections.abc import Iterable
from pathlib import Path, PurePosixPath
from typing import Any

from lambent_proto.v1 import scene_pb2

from lambent_capture.layouts.transforms_json import find_picture, frame_entries, posed_entries
from lambent_capture.layouts.transforms_lens import LENS_KEYS
from lambent_capture.problems import Problems
from lambent_capture.scenes.capture import LIGHT, Capture, training_frame
from lambent_capture.scenes.exposure import stated_exposure
from lambent_capture.scenes.frames import check_sizes
from lambent_capture.scenes.reading import ROOT, read_json_object

NAME = "nerf_blender"
FILES = ("transforms_train.json", "transforms_test.json", "transforms_val.json")

TRUTH_SUFFIXES = {
    "albedo": "_albedo.png",
    "normal": "_normal.png",
    "roughness": "_roughness.png",
    "metallic": "_metallic.png",
    "distance": "_distance.exr",
}


def is_layout(folder: Path) -> bool:
    """Return whether `folder` looks like this layout."""
    return (folder / "transforms_train.json").is_file()


def read_capture(folder: Path, problems: Problems, at: PurePosixPath = ROOT) -> Capture:
    """Return all usable frames of `folder`, whose files lie in its folder `at`; problems go to `problems`."""
    capture = Capture(name=folder.resolve().name, lights=[LIGHT])
    train, *others = ((at / name).as_posix() for name in FILES)
    if not (folder / train).is_file():
        problems.error(
            "scene.file_missing",
            f"{train} does not exist; it holds the cameras of the training photographs",
            train,
        )
        return capture
    splits = [(train, scene_pb2.SPLIT_TRAIN)]
    # Validation frames replace a test split that is missing; otherwise nothing uses them.
    others = [name for name in others if (folder / name).is_file()]
    splits += [(name, scene_pb2.SPLIT_TEST) for name in others[:1]]
    seen: set[str] = set()
    for name, split in splits:
        transforms = read_json_object(folder, name, problems)
        if transforms is not None:
            entries = posed_entries(folder, name, transforms, seen, problems, at)
            _read_split(folder, entries, split, capture, problems)
    for name in others[1:]:
        capture.other_files |= _pictures_named_in(folder, name, at)
    return capture


def _pictures_named_in(folder: Path, name: str, at: PurePosixPath) -> set[str]:
    """Return the pictures named in an unused transforms file, without checking it."""
    unheard = Problems()
    transforms = read_json_object(folder, name, unheard) or {}
    entries = frame_entries(name, transforms, unheard)
    pictures = {find_picture(folder, entry["file_path"], subject, unheard, at) for subject, entry in entries}
    return {path for path in pictures if path is not None}


def _read_split(
    folder: Path,
    entries: Iterable[tuple[str, dict[str, Any], str, scene_pb2.Camera]],
    split: scene_pb2.Split,
    capture: Capture,
    problems: Problems,
) -> None:
    shared_lens = []
    for _, entry, picture, camera in entries:
        frame = _frame(folder, picture, split, camera)
        capture.frames.append(frame)
        exposure = stated_exposure(entry)
        if exposure is not None:
            capture.exposures[frame.name] = exposure
        if not any(key in entry for key in LENS_KEYS):
            shared_lens.append(frame)
    check_sizes(shared_lens, problems)


def _frame(folder: Path, picture: str, split: scene_pb2.Split, camera: scene_pb2.Camera) -> scene_pb2.Frame:
    stem = picture.rsplit(".", maxsplit=1)[0]
    frame = training_frame(picture, camera)
    frame.name, frame.split = stem.replace("/", "_"), split
    for kind, suffix in TRUTH_SUFFIXES.items():
        if (folder / (stem + suffix)).is_file():
            frame.truth[kind] = stem + suffix
    return frame
