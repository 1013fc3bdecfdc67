"""Checks of file names that come from outside: which are allowed, and which belong to a scene."""

import re
import unicodedata
from collections.abc import Iterator
from pathlib import PurePosixPath

from lambent_core.layouts import OWN_FILES, PICTURE_SUFFIXES, TABLE_SUFFIXES

from lambent_server.api.problems import invalid

MAX_PATH_CHARACTERS = 240
MAX_PART_BYTES = 255
SCENE_SUFFIXES = PICTURE_SUFFIXES | TABLE_SUFFIXES
_FORBIDDEN = re.compile(r'[\x00-\x1f\x7f\\:*?"<>|]')
_RESERVED = re.compile(r"(?i)(con|prn|aux|nul|conin\$|conout\$|(com|lpt)[\d¹²³]) *(\..*)?")
# What HFS+ leaves out where it compares names, and other characters without a picture of their own.
_IGNORED = re.compile(
    "[\u00ad\u034f\u061c\u180b-\u180f\u200b-\u200f\u202a-\u202e\u2060-\u206f\ufe00-\ufe0f\ufeff]"
)
_ARCHIVES = (".zip", ".tar", ".tgz", ".tbz2", ".txz", ".gz", ".bz2", ".xz", ".zst", ".7z", ".rar")


def path_problem(path: str) -> str | None:
    """Return why `path` cannot name a file inside a folder on every system, or None if it can."""
    if not path or len(path) > MAX_PATH_CHARACTERS:
        return f"a path has 1 to {MAX_PATH_CHARACTERS} characters"
    if _FORBIDDEN.search(path):
        return 'control characters, backslash and any of :*?"<>| are not allowed'
    parts = path.split("/")
    if any(part in ("", ".", "..") for part in parts):
        return "the path must be relative, without empty parts, '.' or '..'"
    if any(part != part.strip() or part.endswith(".") for part in parts):
        return "parts must not begin or end with a space, nor end with a dot"
    if any(_RESERVED.fullmatch(part) for part in parts):
        return "a part is a reserved name on Windows"
    try:
        if any(len(part.encode("utf-8")) > MAX_PART_BYTES for part in parts):
            return f"a part has more than {MAX_PART_BYTES} bytes"
    except UnicodeEncodeError:
        return "the path is not valid Unicode"
    return None


def check_path(path: str, pointer: str) -> str:
    """Return the path; raises a problem that names it if it is not allowed."""
    problem = path_problem(path)
    if problem is not None:
        raise invalid("path_unsafe", pointer, f"{path[:80]!r}: {problem}")
    return path


def folded(path: str) -> str:
    """Return a key that is equal for paths that clash on some file system.

    File systems ignore case (NTFS), composition (APFS) and characters that are not seen (HFS+).
    """
    path = _IGNORED.sub("", path)
    # Composed again after folding, which takes some letters apart.
    return unicodedata.normalize("NFC", unicodedata.normalize("NFD", path).casefold())


class Names:
    """The paths of a scene so far, none of which clashes with another on any file system."""

    def __init__(self) -> None:
        self._files: dict[str, str] = {}
        self._folders: dict[str, str] = {}

    def add(self, path: str) -> str | None:
        """Return the path that this one clashes with; None if there is none, and this one counts from now on.

        Paths clash that differ in case or composition only, and a file with one that needs it as a folder.
        """
        key = folded(path)
        above = list(_parents(key))
        clash = self._files.get(key) or self._folders.get(key)
        clash = clash or next((self._files[each] for each in above if each in self._files), None)
        if clash is None:
            self._files[key] = path
            self._folders |= dict.fromkeys(above, path)
        return clash


def _parents(path: str) -> Iterator[str]:
    while "/" in path:
        path = path.rpartition("/")[0]
        yield path


def in_archive(name: str) -> str:
    """Return the path that the name of an archive's entry means: "./" and doubled separators are ignored.

    `tar -C scene .` writes the former. What leads out of the folder stays as it is, for `path_problem`.
    """
    if name.startswith("/"):
        return name
    *above, last = name.split("/")
    return "/".join([*(part for part in above if part not in ("", ".")), last])


def clash_with(path: str) -> str:
    """Return what is wrong with a path that clashes with another one, and what to do."""
    return (
        f"clashes with {path!r}: some file systems ignore case, composition or invisible characters, "
        "and no file can be a folder too; rename one"
    )


def is_picture(path: str) -> bool:
    """Return whether a file of this name can be a picture of a scene."""
    return is_scene_file(path) and PurePosixPath(path).suffix.lower() in PICTURE_SUFFIXES


def is_archive(path: str) -> bool:
    """Return whether a file of this name is an archive."""
    return path.lower().endswith(_ARCHIVES)


def is_scene_file(path: str) -> bool:
    """Return whether a file of this name can belong to a scene."""
    pure = PurePosixPath(path)
    hidden = any(part.startswith(".") or part == "__MACOSX" for part in pure.parts)
    known = pure.suffix.lower() in SCENE_SUFFIXES or any(own.fullmatch(pure.name) for own in OWN_FILES)
    return known and not hidden
