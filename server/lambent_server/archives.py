"""Unpacking of untrusted archives: everything is checked before anything is kept.

zip (stored or deflated), tar and tar.gz. Members are written under numbers, never under their own names.
"""

import gzip
import hashlib
import io
import lzma
import stat
import tarfile
import zipfile
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from lambent_server.paths import folded, is_scene_file, path_problem
from lambent_server.problems import Problem, invalid
from lambent_server.settings import Settings

# Archive readers read names and directories in one piece; no legitimate one is larger.
MAX_SINGLE_READ = 16 * 1024 * 1024
PIECE = 1024 * 1024


@dataclass(frozen=True, slots=True)
class Member:
    """A file from an archive, stored on disk under a number."""

    path: str
    sha256: str
    size_bytes: int
    file: Path


def _unsafe(message: str, subject: str = "") -> Problem:
    return invalid("archive_unsafe", f"#/{subject[:80]}" if subject else "#", message)


class _Bounded(io.RawIOBase):
    """A file that returns at most `budget` bytes, and never a large piece at once."""

    def __init__(self, file: IO[bytes], budget: int) -> None:
        self._file = file
        self._budget = budget

    def read(self, size: int | None = -1) -> bytes:
        unlimited = size is None or size < 0
        data = self._file.read(MAX_SINGLE_READ + 1 if unlimited else min(size or 0, MAX_SINGLE_READ + 1))
        if len(data) > MAX_SINGLE_READ:
            raise _unsafe("reading the archive takes too much memory")
        self._spend(len(data))
        return data

    def _spend(self, count: int) -> None:
        self._budget -= count
        if self._budget < 0:
            raise _unsafe("the archive contains more than is allowed")

    def seek(self, offset: int, whence: int = 0) -> int:
        if whence == io.SEEK_SET and offset < 0:
            raise ValueError("an entry starts before the beginning of the file")
        return self._file.seek(offset, whence)

    def tell(self) -> int:
        return self._file.tell()

    def seekable(self) -> bool:
        return True

    def readable(self) -> bool:
        return True


def unpack(archive: Path, folder: Path, settings: Settings) -> tuple[list[Member], list[str]]:
    """Write the files of the archive to `folder`; return them and the paths that do not belong in a scene.

    Raises `archive_unsafe` or `archive_broken`; only files in `folder` may remain then.
    """
    size = archive.stat().st_size
    budget = int(min(settings.max_scene_bytes, settings.max_archive_ratio * max(size, 1)))
    try:
        with archive.open("rb") as file:
            head = file.read(262)
            file.seek(0)
            if head.startswith(b"PK"):
                entries = _zip_entries(file, budget, settings)
            elif head.startswith(b"\x1f\x8b"):
                entries = _tar_entries(gzip.GzipFile(fileobj=file), budget)
            elif head[257:262] == b"ustar":
                entries = _tar_entries(file, budget)
            else:
                raise invalid("archive_broken", "#", "this is neither a zip nor a tar (or tar.gz) archive")
            return _keep(entries, folder, budget, settings)
    except (
        zipfile.BadZipFile,
        tarfile.TarError,
        zlib.error,
        lzma.LZMAError,
        EOFError,
        NotImplementedError,
        UnicodeError,
        ValueError,
        OverflowError,
        gzip.BadGzipFile,
        # tarfile processes headers that announce further headers recursively.
        RecursionError,
    ) as error:
        raise invalid("archive_broken", "#", f"the archive cannot be read: {error}") from error


Entry = tuple[str, int, Any]


def _zip_entries(file: IO[bytes], budget: int, settings: Settings) -> Iterator[Entry]:
    with zipfile.ZipFile(_Bounded(file, 2 * budget + MAX_SINGLE_READ)) as archive:  # type: ignore[arg-type]
        infos = archive.infolist()
        if len(infos) > settings.max_scene_files:
            raise _unsafe(f"the archive has {len(infos)} entries, {settings.max_scene_files} are allowed")
        if sum(info.file_size for info in infos) > budget:
            raise _unsafe(f"the archive holds more than {budget} bytes, by its own account")
        for info in infos:
            # The name as it is in the archive: zipfile cuts it at a null byte.
            kind = stat.S_IFMT(info.external_attr >> 16)
            if kind not in (0, stat.S_IFREG, stat.S_IFDIR):
                raise _unsafe("links and devices are not allowed", info.orig_filename)
            if info.flag_bits & 1:
                raise _unsafe("encrypted entries are not allowed", info.orig_filename)
            if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
                raise _unsafe("only stored and deflated entries are allowed", info.orig_filename)
            if info.orig_filename.endswith("/"):
                _check_name(info.orig_filename.rstrip("/"))
                continue
            with archive.open(info) as member:
                yield info.orig_filename, info.file_size, member


def _tar_entries(file: Any, budget: int) -> Iterator[Entry]:
    # Headers and padding come in addition to the contents.
    with tarfile.open(fileobj=_Bounded(file, 2 * budget + MAX_SINGLE_READ), mode="r:") as archive:  # type: ignore[arg-type]
        while (info := archive.next()) is not None:
            # tarfile keeps every header that it has read.
            archive.members.clear()  # type: ignore[attr-defined]
            if info.isdir():
                _check_name(info.name.rstrip("/"))
                continue
            if not info.isreg() or info.issparse():
                raise _unsafe("links, devices and sparse files are not allowed", info.name)
            member = archive.extractfile(info)
            assert member is not None
            yield info.name, info.size, member


def _check_name(name: str) -> None:
    problem = path_problem(name) if name not in (".", "./", "") else None
    if problem is not None:
        raise _unsafe(problem, name)


def _keep(
    entries: Iterator[Entry], folder: Path, budget: int, settings: Settings
) -> tuple[list[Member], list[str]]:
    members: list[Member] = []
    left_out: list[str] = []
    seen: dict[str, str] = {}
    left = budget
    for place, (given, size, source) in enumerate(entries):
        name = given.removeprefix("./")
        if place >= settings.max_scene_files:
            raise _unsafe(f"the archive has more than {settings.max_scene_files} entries")
        _check_name(name)
        if folded(name) in seen:
            raise _unsafe(f"clashes with {seen[folded(name)]!r}", name)
        seen[folded(name)] = name
        left -= size
        if left < 0:
            raise _unsafe(f"the archive holds more than {budget} bytes")
        if not is_scene_file(name):
            left_out.append(name)
            continue
        members.append(_write(name, size, source, folder / f"{place:06d}"))
    return _without_top_folder(members), left_out


def _write(name: str, size: int, source: IO[bytes], target: Path) -> Member:
    digest, written = hashlib.sha256(), 0
    with target.open("xb") as file:
        while piece := source.read(PIECE):
            written += len(piece)
            if written > size:
                raise _unsafe("an entry is larger than it says", name)
            digest.update(piece)
            file.write(piece)
    if written != size:
        raise invalid("archive_broken", f"#/{name[:80]}", "an entry is shorter than it says")
    return Member(name, digest.hexdigest(), size, target)


def _without_top_folder(members: list[Member]) -> list[Member]:
    """Return the members relative to the single folder that contains them all, if there is one."""
    tops = {member.path.partition("/")[0] for member in members}
    if len(tops) != 1 or any("/" not in member.path for member in members):
        return members
    top = tops.pop() + "/"
    return _without_top_folder(
        [Member(m.path.removeprefix(top), m.sha256, m.size_bytes, m.file) for m in members]
    )
