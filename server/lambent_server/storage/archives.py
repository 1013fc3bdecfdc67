"""Unpacking of untrusted archives: everything is checked before anything is kept.

A process of its own reads the archive (`archive_entries`) and sends what it finds; this side checks every
name and size that it gets, and writes the members under numbers, never under their own names.
"""

import hashlib
import os
from collections.abc import Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Protocol

from lambent_server.api.problems import invalid
from lambent_server.core.settings import Settings
from lambent_server.storage.archive_entries import Entry, broken, unsafe
from lambent_server.storage.decoding import archive_entries
from lambent_server.storage.paths import (
    Names,
    clash_with,
    in_archive,
    is_archive,
    is_picture,
    is_scene_file,
    path_problem,
)

PIECE = 1024 * 1024


@dataclass(frozen=True, slots=True)
class Member:
    """A file from an archive, stored on disk under a number."""

    path: str
    sha256: str
    size_bytes: int
    file: Path


class Room(Protocol):
    """The room for what is unpacked; each method raises the problem if there is none."""

    def entry(self, size: int) -> None:
        """Check that an entry of this size may be read."""

    def writing(self, size: int) -> AbstractContextManager[None]:
        """Return the context in which so many bytes are written."""

    def kept(self, sha256: str, size: int) -> None:
        """Check a file that was written."""


def unpack(archive: Path, folder: Path, settings: Settings, room: Room) -> tuple[list[Member], list[str]]:
    """Write the files of the archive to `folder`; return them and the paths that do not belong in a scene.

    Raises `archive_unsafe`, `archive_broken` or `decoder_stopped`, or what `room` raises; only files in
    `folder` may remain then.
    """
    size = archive.stat().st_size
    budget = int(min(settings.max_scene_bytes, settings.max_archive_ratio * max(size, 1)))
    with archive_entries(archive, budget, settings) as entries:
        return _keep(entries, folder, budget, settings, room)


def _keep(
    entries: Iterator[Entry], folder: Path, budget: int, settings: Settings, room: Room
) -> tuple[list[Member], list[str]]:
    members: list[Member] = []
    left_out: list[str] = []
    names = Names()
    left = budget
    for place, (given, size, source) in enumerate(entries):
        name = in_archive(given)
        if place >= settings.max_scene_files:
            raise unsafe(f"the archive has more than {settings.max_scene_files} entries")
        problem = path_problem(name)
        if problem is not None:
            raise unsafe(problem, name)
        clash = names.add(name)
        if clash is not None:
            raise unsafe(clash_with(clash), name)
        left -= size
        if left < 0:
            raise unsafe(f"the archive holds more than {budget} bytes")
        if not is_scene_file(name):
            left_out.append(name)
            continue
        room.entry(size)
        members.append(_write(name, size, source, folder / f"{place:06d}", room))
    _require_pictures(members, left_out)
    return _without_top_folder(members), left_out


def _require_pictures(members: list[Member], left_out: list[str]) -> None:
    """Refuse an archive that holds other archives and no pictures, or nothing of a scene at all."""
    if any(is_picture(member.path) for member in members):
        return
    nested = [path for path in left_out if is_archive(path)]
    if nested:
        message = f"the archive holds {_some(nested)} and no pictures; unpack it, and send what is in it"
        raise invalid("archive_nested", f"#/{nested[0][:80]}", message)
    if not members:
        contents = f"{_some(left_out)}, and nothing else" if left_out else "no files"
        message = f"the archive holds {contents}; a scene has photographs (JPEG, PNG, ...)"
        raise invalid("archive_empty", "#", message)


def _some(paths: list[str]) -> str:
    """Return the first names of a list, and how many more there are."""
    more = f" and {len(paths) - 3} more" if len(paths) > 3 else ""
    return ", ".join(path[:80] for path in paths[:3]) + more


def _write(name: str, size: int, source: IO[bytes], target: Path, room: Room) -> Member:
    digest, written = hashlib.sha256(), 0
    with target.open("xb", buffering=0) as file:
        while piece := source.read(PIECE):
            written += len(piece)
            if written > size:
                raise unsafe("an entry is larger than it says", name)
            digest.update(piece)
            with room.writing(len(piece)):
                write_all(file.fileno(), piece)
    if written != size:
        raise broken("an entry is shorter than it says", name)
    room.kept(digest.hexdigest(), size)
    return Member(name, digest.hexdigest(), size, target)


def write_all(descriptor: int, data: bytes) -> None:
    """Write all of `data`: a nearly full disk takes what fits."""
    view = memoryview(data)
    while view:
        view = view[os.write(descriptor, view) :]


def _without_top_folder(members: list[Member]) -> list[Member]:
    """Return the members relative to the folder, or the folders, that contain them all."""
    while members and all("/" in member.path for member in members):
        tops = {member.path.partition("/")[0] for member in members}
        if len(tops) != 1:
            break
        top = tops.pop() + "/"
        members = [Member(m.path.removeprefix(top), m.sha256, m.size_bytes, m.file) for m in members]
    return members
