"""Finds the files that a capture names in the spelling of another system.

Programs on Windows write backslashes and ignore case, macOS takes accents apart, and many programs leave a
suffix out or write it twice. A name that fits exactly goes before one that is only spelled alike.
"""

import functools
import os
import unicodedata
from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path, PurePosixPath

from lambent_capture.pictures.pictures import PICTURE_SUFFIXES
from lambent_capture.scenes.links import leads_inside


def folded(name: str) -> str:
    """Return a key that is equal for names that differ in case or in the composition of letters only."""
    return unicodedata.normalize("NFC", unicodedata.normalize("NFD", name).casefold())


def find_file(folder: Path, names: Iterable[PurePosixPath]) -> PurePosixPath | None:
    """Return the path below `folder` of the first of `names` that is a file there, or None.

    Links that lead out of `folder` are not files. Exact spellings of all names are tried first. A spelling
    that fits two files is not used: which of the two is meant cannot be known.
    """
    tried = list(names)
    exact = next((name for name in tried if _is_there(folder, name)), None)
    if exact is not None:
        return exact
    alike = (_spelled_alike(folder, name) for name in tried)
    return next((name for name in alike if name is not None and _is_there(folder, name)), None)


def _is_there(folder: Path, name: PurePosixPath) -> bool:
    return (folder / name).is_file() and leads_inside(folder / name, folder)


def find_picture_file(folder: Path, path: PurePosixPath) -> PurePosixPath | None:
    """Return the picture below `folder` that `path` names, with any supported suffix or none, or None."""
    return find_file(folder, picture_names(path))


def picture_names(path: PurePosixPath) -> list[PurePosixPath]:
    """Return the names that the picture called `path` may have, the most likely first."""
    given = [path] if path.suffix.lower() in PICTURE_SUFFIXES else []
    longer = [path.with_name(path.name + suffix) for suffix in PICTURE_SUFFIXES]
    stem = path.with_suffix("")
    doubled = given and stem.suffix.lower() in PICTURE_SUFFIXES
    return [*given, *longer, *([stem] if doubled else [])]


def other_suffix(folder: Path, path: PurePosixPath) -> PurePosixPath | None:
    """Return a file below `folder` that is called like `path` but for its suffix, or None."""
    parent = _spelled_alike(folder, path.parent) if path.parent.parts else path.parent
    if parent is None:
        return None
    stems = {folded(path.name), folded(path.stem)}
    names_alike = sorted(
        name
        for names in _entries(folder / parent).values()
        for name in names
        if folded(PurePosixPath(name).stem) in stems and (folder / parent / name).is_file()
    )
    return parent / names_alike[0] if names_alike else None


def _spelled_alike(folder: Path, path: PurePosixPath) -> PurePosixPath | None:
    spelled = PurePosixPath()
    for part in path.parts:
        names = _entries(folder / spelled).get(folded(part), ())
        if part not in names and len(names) != 1:
            return None
        spelled /= part if part in names else names[0]
    return spelled


def _entries(folder: Path) -> dict[str, tuple[str, ...]]:
    """Return the names in a folder by their folded form; none where it cannot be read."""
    try:
        changed = folder.stat().st_mtime_ns
    except (OSError, ValueError):  # a name that no file can have
        return {}
    return _listing(os.fspath(folder), changed)


@functools.lru_cache(maxsize=64)  # a capture names thousands of files of a few folders
def _listing(folder: str, changed: int) -> dict[str, tuple[str, ...]]:
    del changed
    names = defaultdict(list)
    try:
        for name in sorted(os.listdir(folder)):
            names[folded(name)].append(name)
    except OSError:
        return {}
    return {key: tuple(values) for key, values in names.items()}
