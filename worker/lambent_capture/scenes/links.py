"""Follows symbolic links as far as they stay in a capture, and tells of those that lead out of it.

What lies outside is never read: a capture may come from other people, and the sandbox of a check forbids it.
"""

import os
from collections.abc import Iterator
from pathlib import Path, PurePosixPath

from lambent_capture.problems import Problems
from lambent_capture.scenes.frames import listed

CLUTTER = frozenset({"__macosx", "@eadir", "lost+found", "$recycle.bin"})
"""Folders that computers add, in lower case."""


def leads_inside(path: Path, within: Path) -> bool:
    """Return whether `path`, with all links on its way, is something that exists in the folder `within`."""
    try:
        return path.resolve(strict=True).is_relative_to(within.resolve())
    except (OSError, RuntimeError):  # leads nowhere, or in a circle
        return False


def files_below(folder: Path, within: Path, astray: list[Path]) -> Iterator[Path]:
    """Yield the ordinary files below `folder`, each once, in order of their paths.

    Left out are hidden files and folders, and `CLUTTER`. Links inside of `within` are followed where that
    leads to files that are not found otherwise; others are added to `astray`.
    """
    real, linked = _walk(folder)
    astray += [path for path in linked if not leads_inside(path, within)]
    known = {path.resolve() for path in real}
    waiting = [path for path in linked if leads_inside(path, within)]
    followed: set[Path] = set()
    while waiting:
        path = waiting.pop(0)
        target = path.resolve()
        if target in known or target in followed:
            continue
        followed.add(target)
        if target.is_file():
            real.append(path)
            known.add(target)
        elif target.is_dir() and not _is_walked(target, folder.resolve()):
            inner, further = _walk(path)
            for each in inner:
                if each.resolve() not in known:
                    real.append(each)
                    known.add(each.resolve())
            astray += [each for each in further if not leads_inside(each, within)]
            waiting += [each for each in further if leads_inside(each, within)]
    yield from sorted(real)


def _walk(folder: Path) -> tuple[list[Path], list[Path]]:
    """Return the files below `folder` and the links, which are not followed."""
    real, linked = [], []
    for place, folders, names in os.walk(folder):
        here = Path(place)
        kept = [name for name in folders if not is_clutter(name)]
        linked += [here / name for name in kept if (here / name).is_symlink()]
        folders[:] = [name for name in kept if not (here / name).is_symlink()]
        paths = [here / name for name in names if not name.startswith(".")]
        linked += [path for path in paths if path.is_symlink()]
        real += [path for path in paths if not path.is_symlink() and path.is_file()]
    return real, sorted(linked)


def is_clutter(name: str) -> bool:
    """Return whether a folder of this name is hidden, or one that computers add."""
    return name.startswith(".") or name.lower() in CLUTTER


def _is_walked(target: Path, folder: Path) -> bool:
    """Return whether the files of a folder are found without a link to it."""
    if target == folder or folder.is_relative_to(target):
        return True
    if not target.is_relative_to(folder):
        return False
    return not any(is_clutter(part) for part in target.relative_to(folder).parts)


def links_out(folder: Path) -> list[Path]:
    """Return the links below `folder` that lead to something that exists outside of it, in order."""
    _, linked = _walk(folder)
    return [path for path in linked if path.exists() and not leads_inside(path, folder)]


def link_out(folder: Path, path: PurePosixPath) -> PurePosixPath | None:
    """Return the link on the way to `path` that leads out of `folder` to something there, or None."""
    if leads_inside(folder / path, folder) or not (folder / path).exists():
        return None
    ways = [*reversed(path.parents), path]
    return next((each for each in ways if each.parts and not leads_inside(folder / each, folder)), path)


def refuse_links(folder: Path, problems: Problems) -> bool:
    """Return whether no link below `folder` leads out of it, after noting an error where one does."""
    astray = links_out(folder)
    note_links(astray, folder, problems, needed=True)
    return not astray


def settle_linked(folder: Path, problems: Problems) -> bool:
    """Return whether no frame's picture is behind a link out of `folder`; an error names such links.

    Links that nothing needs are noted.
    """
    subjects = problems.take_lost("scene.file_linked")
    ways = {link_out(folder, PurePosixPath(subject)) for subject in subjects}
    needed = sorted({folder / way for way in ways if way is not None})
    note_links(needed, folder, problems, needed=True)
    if problems.usable:
        note_links(_astray(folder), folder, problems)
    return not needed


def _astray(folder: Path) -> list[Path]:
    return [path for path in _walk(folder)[1] if not leads_inside(path, folder)]


def note_links(astray: list[Path], folder: Path, problems: Problems, *, needed: bool = False) -> None:
    """Note the links `astray` of the capture in `folder`, as an error where they are needed."""
    if not astray:
        return
    names = [shown_name(path, folder) for path in astray]
    note = problems.error if needed else problems.warning
    note(
        "scene.file_linked",
        f"{listed(names)}: a link that leads nowhere or out of this folder is not followed; copy the files "
        "themselves",
        names[0],
    )


def shown_name(path: Path, folder: Path) -> str:
    """Return how to call a file in messages, even if its name is not text."""
    name = path.relative_to(folder).as_posix().encode("utf-8", "replace").decode("utf-8")
    return "".join(letter if letter.isprintable() else "?" for letter in name)
