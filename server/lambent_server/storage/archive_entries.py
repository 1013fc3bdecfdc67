"""The entries of an archive: zip (stored or deflated), tar and tar.gz, read in a process of its own.

Only that process runs the readers of the standard library on untrusted bytes. It needs no other library.
"""

import gzip
import io
import lzma
import stat
import tarfile
import zipfile
import zlib
from collections.abc import Iterator
from typing import IO, Any

from lambent_server.api.problems import Problem, invalid
from lambent_server.storage.paths import in_archive, path_problem

# Archive readers read names and directories in one piece; no legitimate one is larger.
MAX_SINGLE_READ = 16 * 1024 * 1024
_LOCAL_HEADER = 30
_PIECE = 1024 * 1024
_END = b"PK\x05\x06"
# With the records of large archives, and a comment.
_MAX_END = 2**17
# What some programs write in front of an archive that might have become several files.
_MARKERS = (b"PK00", b"PK\x07\x08")
_LINK = "a link is not followed; pack the file that it names (tar -h, or zip without -y)"

Entry = tuple[str, int, Any]
"""Name, size as it is claimed, and something with `read`."""

READER_ERRORS = (
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
    # zipfile looks up names and versions, and unpacks fields, without checks of its own.
    KeyError,
    IndexError,
    # tarfile processes headers that announce further headers recursively.
    RecursionError,
)
"""What the readers raise where an archive is damaged."""


def unsafe(message: str, subject: str = "") -> Problem:
    """Return the problem of an archive, or of the entry `subject`, that is refused."""
    return invalid("archive_unsafe", f"#/{subject[:80]}" if subject else "#", message)


def broken(message: str, subject: str = "") -> Problem:
    """Return the problem of an archive that cannot be read."""
    return invalid("archive_broken", f"#/{subject[:80]}" if subject else "#", message)


def entries_of(file: IO[bytes], budget: int, max_files: int) -> Iterator[Entry]:
    """Yield the files of an archive, not its folders; raises `archive_unsafe` or `archive_broken`.

    `budget` is how many bytes all of them may have together.
    """
    head = file.read(262)
    file.seek(0)
    try:
        if head.startswith(b"PK"):
            yield from _zip_entries(file, budget, max_files)
        elif head.startswith(b"\x1f\x8b"):
            yield from _tar_entries(gzip.GzipFile(fileobj=file), budget)
        elif head[257:262] == b"ustar":
            yield from _tar_entries(file, budget)
        else:
            raise broken("this is neither a zip nor a tar (or tar.gz) archive")
    except READER_ERRORS as error:
        raise broken(f"the archive cannot be read: {error}") from error


class _Bounded(io.RawIOBase):
    """A file that returns at most `budget` bytes, and never a large piece at once."""

    def __init__(self, file: IO[bytes], budget: int) -> None:
        self._file = file
        self._budget = budget

    def read(self, size: int | None = -1) -> bytes:
        unlimited = size is None or size < 0
        data = self._file.read(MAX_SINGLE_READ + 1 if unlimited else min(size or 0, MAX_SINGLE_READ + 1))
        if len(data) > MAX_SINGLE_READ:
            raise unsafe("reading the archive takes too much memory")
        self._spend(len(data))
        return data

    def _spend(self, count: int) -> None:
        self._budget -= count
        if self._budget < 0:
            raise unsafe("the archive contains more than is allowed")

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


def _zip_entries(file: IO[bytes], budget: int, max_files: int) -> Iterator[Entry]:
    with zipfile.ZipFile(_Bounded(file, 2 * budget + MAX_SINGLE_READ)) as archive:
        infos = archive.infolist()
        _refuse_others(archive, infos, file)
        if len(infos) > max_files:
            raise unsafe(f"the archive has {len(infos)} entries, {max_files} are allowed")
        if sum(info.file_size for info in infos) > budget:
            raise unsafe(f"the archive holds more than {budget} bytes, by its own account")
        _refuse_overlaps(infos)
        for info in infos:
            # The name as it is in the archive: zipfile cuts it at a null byte.
            name = info.orig_filename
            kind = stat.S_IFMT(info.external_attr >> 16)
            if kind not in (0, stat.S_IFREG, stat.S_IFDIR):
                raise unsafe(_LINK if kind == stat.S_IFLNK else "devices are not allowed", name)
            if info.flag_bits & 1:
                raise unsafe("encrypted entries are not allowed", name)
            if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
                raise unsafe("only stored and deflated entries are allowed", name)
            if name.endswith("/"):
                _check_folder(name.rstrip("/"))
                if info.file_size:
                    raise unsafe("a folder has contents of its own", name)
                continue
            with archive.open(info) as member:
                yield name, info.file_size, member


def _refuse_others(archive: zipfile.ZipFile, infos: list[zipfile.ZipInfo], file: IO[bytes]) -> None:
    """Refuse a file that holds more than one zip: which of them a reader sees depends on the reader."""
    file.seek(0)
    start = 4 if file.read(4) in _MARKERS else 0
    first = min((info.header_offset for info in infos), default=archive.start_dir)
    if first != start:
        raise unsafe(
            f"{first - start} bytes come before its first entry: these are two archives joined, or one that "
            "unpacks itself; pack the files again as one plain zip"
        )
    # The list of entries, its end and a comment: there may be no second end.
    file.seek(archive.start_dir)
    if file.read(MAX_SINGLE_READ + _MAX_END).count(_END) != 1:
        raise unsafe("the archive has more than one end; pack the files again as one plain zip")


def _refuse_overlaps(infos: list[zipfile.ZipInfo]) -> None:
    """Refuse entries that share bytes of the archive: what a reader sees depends on the reader."""
    end, before = 0, ""
    for info in sorted(infos, key=lambda each: each.header_offset):
        if info.header_offset < end:
            raise unsafe(f"shares bytes with {before!r}", info.orig_filename)
        end, before = info.header_offset + _LOCAL_HEADER + info.compress_size, info.orig_filename


def _tar_entries(file: Any, budget: int) -> Iterator[Entry]:
    # Headers and padding come in addition to the contents.
    bounded = _Bounded(file, 2 * budget + MAX_SINGLE_READ)
    with tarfile.open(fileobj=bounded, mode="r:") as archive:
        while (info := archive.next()) is not None:
            # tarfile keeps every header that it has read.
            archive.members.clear()  # type: ignore[attr-defined]
            if info.isdir():
                _check_folder(info.name.rstrip("/"))
                continue
            if not info.isreg() or info.issparse():
                linked = info.issym() or info.islnk()
                raise unsafe(_LINK if linked else "devices and sparse files are not allowed", info.name)
            member = archive.extractfile(info)
            assert member is not None
            yield info.name, info.size, member
    # A compressed archive has its checksum at the very end.
    while bounded.read(_PIECE):
        pass


def _check_folder(name: str) -> None:
    name = in_archive(f"{name}/").rstrip("/")
    problem = path_problem(name) if name else None
    if problem is not None:
        raise unsafe(problem, name)
