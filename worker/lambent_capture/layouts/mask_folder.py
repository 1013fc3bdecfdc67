"""Assigns masks from a separate folder to the frames of a capture."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path, PurePosixPath

from lambent_proto.v1 import scene_pb2

from lambent_capture.layouts.mask_search import masks_of, names_of_mask
from lambent_capture.layouts.picture_files import pictures_below
from lambent_capture.pictures.coverage import fits
from lambent_capture.pictures.picture_error import PictureError
from lambent_capture.pictures.pictures import PICTURE_SUFFIXES, picture_size
from lambent_capture.problems import Problems
from lambent_capture.scenes.frames import listed
from lambent_capture.scenes.links import files_below


def attach_masks(
    manifest: scene_pb2.SceneManifest, folder: Path, masks_dir: Path, problems: Problems
) -> None:
    """Set `Frame.mask` of every frame of the capture in `folder` to its mask in `masks_dir`.

    A mask is named like the frame (`train_003.png`), like its picture's path (`images/0001.png`), or like its
    picture where no other has that name (`0001.png`; `0001.jpg.png`, as COLMAP wants them, is taken as well).
    Paths are relative to `folder` where the masks lie in it, else absolute. Frames without a mask and masks
    without a frame go to `problems`.
    """
    if not masks_dir.is_dir():
        problems.error(
            "scene.mask_folder_missing",
            f'--masks "{masks_dir.name}" is not a folder; give the folder with a mask for every picture',
        )
        return
    files = _files_by_name(masks_dir)
    stems = Counter(PurePosixPath(frame.images[0].path).stem for frame in manifest.frames)
    used: set[Path] = set()
    lacking = []
    for frame in manifest.frames:
        file = next((files[name] for name in _names(frame, stems) if name in files), None)
        if file is None:
            lacking.append(frame.name)
            continue
        used.add(file)
        inside = file.is_relative_to(folder)
        frame.mask = (file.relative_to(folder) if inside else file.resolve()).as_posix()
        frame.mask_encoding = ""
    if lacking:
        problems.error(
            "scene.mask_file_missing",
            f"{len(lacking)} of {len(manifest.frames)} frames have no mask in {masks_dir.name}: "
            f"{listed(lacking)}; name each like its frame or its picture, for example {lacking[0]}.png",
            lacking[0],
        )
    left = sorted(path.relative_to(masks_dir).as_posix() for path in set(files.values()) - used)
    if left and not lacking:
        problems.warning(
            "scene.mask_unused",
            f"{len(left)} masks in {masks_dir.name} belong to no frame: {listed(left)}; remove them, or "
            "check the names",
            left[0],
        )


def _names(frame: scene_pb2.Frame, stems: Counter[str]) -> list[str]:
    """Return the names without suffix that a mask of the frame may have, the surest first."""
    path = PurePosixPath(frame.images[0].path)
    names = [frame.name, path.with_suffix("").as_posix(), path.as_posix()]
    if path.parts[0] == "images" and len(path.parts) > 1:
        inner = PurePosixPath(*path.parts[1:])
        names += [inner.with_suffix("").as_posix(), inner.as_posix()]
    if stems[path.stem] == 1:
        names += [path.stem, path.name]
    return names


def _files_by_name(folder: Path) -> dict[str, Path]:
    """Return the pictures below `folder` by what their photographs may be called, in it without suffix."""
    paths = [path for path in files_below(folder, folder, []) if path.suffix.lower() in PICTURE_SUFFIXES]
    exact: dict[str, Path] = {}
    alike: dict[str, Path] = {}
    for path in paths:
        name = path.relative_to(folder).with_suffix("")
        exact[name.as_posix()] = path
        alike |= {name.with_name(called).as_posix(): path for called in names_of_mask(name.name)}
    return alike | exact


def masks_beside(folder: Path, photographs: Sequence[str], problems: Problems) -> dict[str, str]:
    """Return the masks next to `photographs` of the capture in `folder`, if all have a fitting one.

    Paths are relative to `folder`. Masks that are not used are noted in `problems`.
    """
    masks = masks_of(photographs, pictures_below(folder), problems)
    for name, mask in masks.items():
        try:
            fitting = fits(folder / mask, folder / name)
            sizes = [picture_size(folder / each) for each in (mask, name)]
        except PictureError:  # the photograph, which is noted elsewhere, or a mask that will be
            continue
        if not fitting:
            problems.warning(
                "scene.mask_unused",
                f"the {len(masks)} masks beside the photographs are not used, because {mask} has "
                f"{sizes[0][0]} x {sizes[0][1]} pixels and its photograph {sizes[1][0]} x {sizes[1][1]}; "
                "make them one size, or remove the masks",
                mask,
            )
            return {}
    return masks


def attach_masks_beside(frames: Sequence[scene_pb2.Frame], folder: Path, problems: Problems) -> None:
    """Give `frames` of the capture in `folder` the masks next to their photographs, if all have one.

    Frames that have masks already, and captures that have none, are left as they are; masks that are not used
    are noted in `problems`.
    """
    if any(frame.mask for frame in frames):
        return
    names = [frame.images[0].path for frame in frames]
    masks = masks_beside(folder, names, problems)
    for frame, name in zip(frames, names, strict=True):
        frame.mask = masks.get(name, "")
