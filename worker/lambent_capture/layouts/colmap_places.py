"""Finds the sparse model of a capture, and the photographs that it is about.

COLMAP leaves one numbered folder for each group of photographs that it could not join (`sparse/0`,
`sparse/1`); other programs put the model elsewhere, and its photographs under another name.
"""

import os
import struct
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path, PurePosixPath

from lambent_capture.layouts.colmap_model import MAX_ENTRIES, ModelError, read_images
from lambent_capture.layouts.named_files import find_file
from lambent_capture.problems import Problems
from lambent_capture.scenes.frames import listed
from lambent_capture.scenes.links import is_clutter, leads_inside, link_out
from lambent_capture.scenes.reading import ROOT

GROUPS = ("sparse", "colmap/sparse", "distorted/sparse", "colmap", ".")
"""Where models lie, each directly or in folders of its own; the first group that has models is used."""
IMAGES = "images"
PICTURE_FOLDERS = (
    *(IMAGES, "input", "image", "imgs", "photos", "rgb", "color", "frames"),
    *("images_2", "images_4", "images_8"),
)
"""Where photographs lie, the most likely first; the folder itself is the last."""
MAX_MODELS = 100
MAX_DEPTH, MAX_FOLDERS = 3, 2000
"""How far photographs and cameras are looked for."""
_SUFFIXES = (".bin", ".txt")
_LEAST_IMAGE_BYTES = 73
_COUNT = struct.Struct("<Q")
_SAMPLE = 200
"""Names of a model that are looked for to tell which folder holds its photographs."""


def model_folder(folder: Path) -> str | None:
    """Return where in `folder` the largest sparse model lies, or None where there is none."""
    places = _models(folder)
    return _largest(folder, places)[0] if places else None


def chosen_model(folder: Path, at: PurePosixPath, problems: Problems) -> str | None:
    """Return what `model_folder` says of the folder `at` of a capture, after noting what else there is."""
    places = _models(folder / at)
    if not places:
        return None
    model, numbers = _largest(folder / at, places)
    others = [f"{at / place} ({numbers[place]})" for place in places if place != model]
    if others:
        problems.warning(
            "scene.models_several",
            f"there are {len(places)} sparse models, of which the largest is used: {at / model} with "
            f"{numbers[model]} photographs, not {listed(others)}; COLMAP splits photographs that it cannot "
            "join, so take more in between, or remove the models that should not be used",
            (at / model).as_posix(),
        )
    return (at / model).as_posix()


def picture_folder(folder: Path, at: PurePosixPath, model: str, names: Sequence[str]) -> PurePosixPath:
    """Return where in `folder` the photographs lie that the model calls `names`.

    It is the first usual place that has at least half of them, seen from `at` and then from the folders
    around it, or another folder that has, else the one that has most.
    """
    places = list(_picture_places(at, model))
    step = max(1, len(names) // _SAMPLE)
    sample = [PurePosixPath(name.replace("\\", "/")) for name in names[::step]]
    best, most = places[0], 0
    others = (place for place in folders_below(folder) if place not in places)
    for place in (*places, *others):
        if not (folder / place).is_dir():
            continue
        count = sum(_is_there(folder / place, name) for name in sample)
        if 2 * count >= max(1, len(sample)):
            return place
        if count > most:
            best, most = place, count
    return best


def _picture_places(at: PurePosixPath, model: str) -> Iterable[PurePosixPath]:
    # Programs that undistort keep what they were given in input/, with its model below distorted/.
    first = ("input",) if "distorted" in PurePosixPath(model).parts else ()
    for base in (at, *at.parents):
        yield from (base / name for name in (*first, *PICTURE_FOLDERS))
        yield base


def folders_below(folder: Path) -> Iterator[PurePosixPath]:
    """Yield the folders below `folder`, outer ones first, `MAX_DEPTH` deep and without following links."""
    waiting = [ROOT]
    for _ in range(MAX_FOLDERS):
        if not waiting:
            return
        place = waiting.pop(0)
        if place != ROOT:
            yield place
        if len(place.parts) < MAX_DEPTH:
            paths = [place / name for name in names_in(folder / place) if not is_clutter(name)]
            waiting += [each for each in paths if _is_own_folder(folder / each)]


def names_in(folder: Path) -> list[str]:
    """Return the names in a folder in order; none where it cannot be read."""
    try:
        return sorted(os.listdir(folder))
    except OSError:
        return []


def _is_own_folder(path: Path) -> bool:
    return path.is_dir() and not path.is_symlink()


def _is_there(folder: Path, name: PurePosixPath) -> bool:
    if name.is_absolute() or ".." in name.parts:
        return False
    try:
        return find_file(folder, [name]) is not None or link_out(folder, name) is not None
    except (OSError, ValueError):  # a name that no file can have
        return False


def _models(folder: Path) -> list[str]:
    """Return the folders of the first group that has models, in numerical order."""
    for group in GROUPS:
        try:
            inner = sorted(path.name for path in (folder / group).iterdir() if path.is_dir())
        except OSError:
            continue
        inner = sorted(inner, key=lambda name: (not name.isdecimal(), int(name) if name.isdecimal() else 0))
        numbered = [PurePosixPath(group, name).as_posix() for name in inner]
        if group == ".":
            # A list of images is called images.txt as well.
            if _suffix(folder, "images") and _suffix(folder, "cameras"):
                return ["."]
            continue
        models = [place for place in (*numbered, group) if _suffix(folder / place, "images")]
        if models:
            return models[:MAX_MODELS]
    return []


def _suffix(folder: Path, name: str) -> str | None:
    return next((suffix for suffix in _SUFFIXES if (folder / f"{name}{suffix}").is_file()), None)


def images_file(model: Path) -> Path:
    """Return the file of the registered images of a model: the binary one where there are both."""
    return model / f"images{_suffix(model, 'images') or _SUFFIXES[0]}"


def _largest(folder: Path, places: Sequence[str]) -> tuple[str, dict[str, int]]:
    """Return the place with most registered photographs, and how many each has."""
    if len(places) == 1:
        return places[0], {}
    numbers = {place: _num_images(folder, images_file(folder / place)) for place in places}
    return max(places, key=lambda place: numbers[place]), numbers


def _num_images(folder: Path, path: Path) -> int:
    """Return how many photographs a model has, 0 where it cannot be read."""
    if not leads_inside(path, folder):
        return 0
    try:
        if path.suffix != ".bin":
            return len(read_images(path))
        with path.open("rb") as file:
            (count,) = _COUNT.unpack(file.read(_COUNT.size))
        fits = count <= MAX_ENTRIES and _COUNT.size + count * _LEAST_IMAGE_BYTES <= path.stat().st_size
        return int(count) if fits else 0
    except (ModelError, OSError, struct.error):
        return 0
