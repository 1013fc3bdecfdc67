"""Finds the masks next to photographs: in a folder of their own, or as a second file of each.

images/0001.jpg   masks/0001.png  mask/0001.jpg.png  images_masks/0001_mask.png  segmentation/0001.png
0001.jpg          0001_mask.png   0001.mask.png      0001.jpg.mask.png           mask_0001.png
"""

import re
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath

from lambent_capture.layouts.named_files import folded
from lambent_capture.pictures.pictures import PICTURE_SUFFIXES
from lambent_capture.problems import Problems
from lambent_capture.scenes.frames import listed

MASK_FOLDERS = frozenset({"mask", "masks"})
"""Folders whose pictures are never photographs."""
_WORDS = "masks?|segmentations?|silhouettes?|mattes?"
_FOLDER = re.compile(rf"(.+[._-])?({_WORDS})|masks?[._-].+", re.IGNORECASE)
_AFTER = re.compile(rf"(.+?)[._ -](?:{_WORDS}|seg)", re.IGNORECASE)
_BEFORE = re.compile(r"masks?[._ -](.+)", re.IGNORECASE)
LEAST_SHARE = 0.5
"""Share of the pictures in a folder not in `MASK_FOLDERS` that must be called like photographs."""


@dataclass(frozen=True, slots=True)
class MaskPlace:
    """Masks that lie in one place, or next to their photographs."""

    name: str
    """How to call it in messages."""
    masks: dict[str, str]
    """Path of the mask by that of the photograph."""
    files: tuple[str, ...]
    """All pictures there, masks of no photograph among them."""


def mask_places(pictures: Sequence[str]) -> list[MaskPlace]:
    """Return where among `pictures` (paths with forward slashes) masks of others lie, the surest first."""
    folders: dict[str, list[str]] = defaultdict(list)
    for name in pictures:
        inside = _mask_folder(name)
        if inside is not None:
            folders[inside].append(name)
    candidates = {name for files in folders.values() for name in files}
    others = [name for name in pictures if name not in candidates]
    places, doubtful = [], []
    for folder, files in folders.items():
        place = _matched(folder, files, others)
        if PurePosixPath(folder).name.lower() in MASK_FOLDERS:
            places.append(place)
        elif len(place.masks) >= LEAST_SHARE * len(files):
            doubtful.append(place)
    sidecars = _sidecars(others)
    return [*places, *doubtful, *([sidecars] if sidecars.masks else [])]


def photographs_among(pictures: Sequence[str]) -> list[str]:
    """Return those of `pictures` that are not masks of others."""
    masks = {name for place in mask_places(pictures) for name in place.files}
    return [name for name in pictures if name not in masks]


def masks_of(photographs: Sequence[str], pictures: Sequence[str], problems: Problems) -> dict[str, str]:
    """Return the masks that `pictures` have for `photographs`, all of which have one, or none.

    What is not used is noted in `problems`.
    """
    used: dict[str, str] = {}
    for place in mask_places(pictures):
        wanted = [name for name in photographs if name not in place.files]
        covered = {name: place.masks[name] for name in wanted if name in place.masks}
        if not wanted:
            continue
        if not used and len(covered) == len(photographs):
            used = covered
            continue
        lacking = [name for name in wanted if name not in covered]
        reason = (
            "other masks are used"
            if used
            else f"{len(lacking)} of {len(photographs)} photographs have none there: {listed(lacking)}"
        )
        problems.warning(
            "scene.mask_unused",
            f"{len(place.files)} masks ({place.name}) are not used, because {reason}; give one for each "
            "photograph, named alike, or remove them",
            place.files[0],
        )
    return used


def names_of_mask(stem: str) -> Iterator[str]:
    """Yield what the photograph of a mask may be called, without its suffix; `stem` has none itself."""
    yield stem
    for form in (_AFTER, _BEFORE):
        match = form.fullmatch(stem)
        if match:
            yield match[1]


def _mask_folder(name: str) -> str | None:
    """Return the outermost folder of a picture that is called like one of masks, or None."""
    parts = PurePosixPath(name).parts[:-1]
    for depth, part in enumerate(parts):
        if _FOLDER.fullmatch(part):
            return "/".join(parts[: depth + 1])
    return None


def _matched(folder: str, files: Sequence[str], photographs: Sequence[str]) -> MaskPlace:
    """Return which of the masks in `folder` belongs to which photograph."""
    tails = _tails(photographs)
    masks: dict[str, str] = {}
    for name in files:
        inner = PurePosixPath(name).relative_to(folder)
        for called in names_of_mask(_bare(inner.name)):
            photograph = tails.get(folded((inner.parent / called).as_posix()))
            if photograph is not None:
                masks.setdefault(photograph, name)
                break
    return MaskPlace(f"{folder}/", masks, tuple(files))


def _sidecars(pictures: Sequence[str]) -> MaskPlace:
    """Return the masks next to their photographs."""
    by_name = {folded(_without_suffix(name)): name for name in reversed(pictures)}
    masks: dict[str, str] = {}
    for name in pictures:
        path = PurePosixPath(name)
        for called in list(names_of_mask(_bare(path.name)))[1:]:
            photograph = by_name.get(folded((path.parent / called).as_posix()))
            if photograph is not None and photograph != name:
                masks.setdefault(photograph, name)
                break
    files = tuple(sorted(masks.values()))
    return MaskPlace(f"{files[0]} and so on" if files else "", masks, files)


def _tails(photographs: Sequence[str]) -> dict[str, str]:
    """Return the photographs by every end of their path that only one of them has, without suffix."""
    ends: dict[str, list[str]] = defaultdict(list)
    for name in photographs:
        path = PurePosixPath(_without_suffix(name))
        for start in range(len(path.parts)):
            ends[folded("/".join(path.parts[start:]))].append(name)
    counts = Counter({end: len(names) for end, names in ends.items()})
    return {end: names[0] for end, names in ends.items() if counts[end] == 1}


def _without_suffix(name: str) -> str:
    return PurePosixPath(name).with_suffix("").as_posix()


def _bare(name: str) -> str:
    """Return the name of a picture without its suffixes: COLMAP's masks are called `0001.jpg.png`."""
    path = PurePosixPath(name)
    while path.suffix.lower() in PICTURE_SUFFIXES:
        path = path.with_suffix("")
    # 0001.jpg.mask.png: the mask's own name ends before the photograph's suffix.
    match = _AFTER.fullmatch(path.name)
    if match and PurePosixPath(match[1]).suffix.lower() in PICTURE_SUFFIXES:
        return f"{PurePosixPath(match[1]).stem}.mask"
    return path.name
