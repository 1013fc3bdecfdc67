"""Reads the transforms.json of nerfstudio and instant-ngp: one file for all frames.

Each frame has `file_path`, `transform_matrix` (camera-to-world, camera axes x right, y up, looking along -z),
and may have a lens of its own, `mask_path`, and `exposure_time`, `f_number`, `iso`. `train_filenames`,
`test_filenames` and `val_filenames` may say what is trained on. Lenses: see `transforms_lens`.
"""

from pathlib import Path, PurePosixPath
from typing import Any

from lambent_proto.v1 import scene_pb2

from lambent_capture.layouts.named_files import find_file, folded, picture_names
from lambent_capture.layouts.transforms_json import posed_entries
from lambent_capture.layouts.transforms_lens import LENS_KEYS
from lambent_capture.problems import Problems
from lambent_capture.scenes.capture import LIGHT, Capture, training_frame
from lambent_capture.scenes.exposure import stated_exposure
from lambent_capture.scenes.frames import check_sizes, listed, name_frames
from lambent_capture.scenes.links import link_out
from lambent_capture.scenes.reading import ROOT, inside_folder, read_json_object

NAME = "nerfstudio"

FILE = "transforms.json"
SPLITS = (
    ("train_filenames", scene_pb2.SPLIT_TRAIN),
    ("test_filenames", scene_pb2.SPLIT_TEST),
    ("val_filenames", scene_pb2.SPLIT_TEST),
)


def is_layout(folder: Path) -> bool:
    """Return whether `folder` looks like this layout."""
    return (folder / FILE).is_file()


def read_capture(folder: Path, problems: Problems, at: PurePosixPath = ROOT) -> Capture:
    """Return all usable frames of `folder`, whose file lies in its folder `at`; problems go to `problems`."""
    capture = Capture(name=folder.resolve().name, lights=[LIGHT], up_is_z=False)
    file = (at / FILE).as_posix()
    transforms = read_json_object(folder, file, problems)
    if transforms is None:
        return capture
    shared_lens = []
    for subject, entry, picture, camera in posed_entries(folder, file, transforms, set(), problems, at):
        frame = training_frame(picture, camera)
        if not _read_mask(folder, at, entry, subject, frame, problems):
            continue
        capture.frames.append(frame)
        exposure = stated_exposure(entry)
        if exposure is not None:
            capture.exposures[picture] = exposure
        if not any(key in entry for key in LENS_KEYS):
            shared_lens.append(frame)
    check_sizes(shared_lens, problems)
    _choose_splits(at, transforms, capture, problems)
    names = name_frames(capture.frames)
    capture.exposures = {names[path]: value for path, value in capture.exposures.items() if path in names}
    return capture


def _read_mask(
    folder: Path,
    at: PurePosixPath,
    entry: dict[str, Any],
    subject: str,
    frame: scene_pb2.Frame,
    problems: Problems,
) -> bool:
    """Fill in the frame's mask; return whether what the entry says about it holds."""
    path = entry.get("mask_path")
    if path is None:
        return True
    clean = inside_folder(path, subject, problems, at) if isinstance(path, str) else None
    if clean is None:
        if not isinstance(path, str):
            problems.error("scene.file_path_missing", f"{subject}: mask_path must name a picture", subject)
        return False
    mask = find_file(folder, [clean, *picture_names(clean)])
    above = inside_folder(path, subject, Problems()) if mask is None and at.parts else None
    if above is not None:
        mask = find_file(folder, [above, *picture_names(above)])
    if mask is None and link_out(folder, clean) is not None:
        problems.lost("scene.file_linked", f"{subject}: {clean} lies behind a link out", clean.as_posix())
        return False
    if mask is None:
        problems.error(
            "scene.file_missing",
            f"{subject}: there is no mask {clean}; add it, or remove mask_path to take "
            "everything for the object",
            clean.as_posix(),
        )
        return False
    frame.mask = mask.as_posix()
    return True


def _choose_splits(
    at: PurePosixPath, transforms: dict[str, Any], capture: Capture, problems: Problems
) -> None:
    """Set the split of each frame from the file's lists; frames in none of them are left out."""
    lists: dict[str, set[str]] = {}
    shown: dict[str, str] = {}
    for key, _ in SPLITS:
        names = transforms.get(key)
        if names is None:
            continue
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            problems.error(
                "scene.metadata_unreadable", f"{FILE}: {key} must be a list of file names; fix it", FILE
            )
            continue
        lists[key] = {_key(name, at) for name in names}
        shown |= {_key(name, at): name for name in names}
        if len(lists[key]) != len(names):
            problems.error("scene.frame_duplicate", f"{FILE}: {key} names a picture twice; remove one", FILE)
    if not lists:
        return
    if lists.get("test_filenames"):
        validation = lists.pop("val_filenames", set()) - lists["test_filenames"]
    else:
        validation = set()
    known = {key for frame in capture.frames for key in _keys(frame.images[0].path)}
    absent = sorted(shown[name] for names in lists.values() for name in names if name not in known)
    if absent and problems.usable:
        problems.error(
            "scene.file_missing",
            f"{FILE}: the split lists name pictures that no frame has ({listed(absent)}); correct the lists",
            absent[0],
        )
    kept = []
    unused = []
    for frame in capture.frames:
        path = frame.images[0].path
        split = next((s for key, s in SPLITS if _is_listed(path, lists.get(key, set()))), None)
        if split is not None:
            frame.split = split
            kept.append(frame)
            continue
        capture.other_files |= {path, frame.mask}
        if not _is_listed(path, validation):
            unused.append(path)
    if unused:
        problems.warning(
            "scene.extra_file",
            f"{FILE}: {listed(unused)} in none of the split lists; not used",
            unused[0],
        )
    capture.frames = kept


def _is_listed(path: str, names: set[str]) -> bool:
    return not _keys(path).isdisjoint(names)


def _keys(path: str) -> set[str]:
    """Return what a list of files may call a picture, as `_key` gives it."""
    return {folded(path), folded(path.rsplit(".", maxsplit=1)[0])}


def _key(name: str, at: PurePosixPath) -> str:
    """Return a name in a list of files as a path below the capture's folder, for comparison."""
    return folded((at / name.replace("\\", "/").removeprefix("./")).as_posix())
