"""The files of a bundle, from a folder or a zip archive, trusted only after they have been checked.

Nothing is unpacked to disk. A path is accepted when it is relative, has no "..", and names a plain file
(no link, no device) of the size and SHA-256 the manifest states.
"""

import hashlib
import lzma
import stat
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path, PurePosixPath
from typing import IO, Protocol

from lambent_core.errors import BundleError

MAX_FILES = 4096
MAX_FILE_BYTES = 4 << 30
_BLOCK = 1 << 20
# What reading an entry of a damaged archive raises. RuntimeError: it is encrypted, whatever the list says.
_UNREADABLE = (
    *(OSError, zipfile.BadZipFile, NotImplementedError, EOFError, ValueError, RuntimeError),
    *(zlib.error, lzma.LZMAError),
)


class FileSource(Protocol):
    """Read access to the files of a bundle by their path inside it."""

    def paths(self) -> set[str]:
        """Return every file there is; raises BundleError for anything that is not a plain file."""

    def size_bytes(self, path: str) -> int:
        """Return the size of a file."""

    def open(self, path: str) -> AbstractContextManager[IO[bytes]]:
        """Return an open file, for use in a `with` statement."""


def check_path(path: str) -> None:
    """Raise BundleError unless `path` is a plain relative path inside the bundle."""
    parts = PurePosixPath(path).parts
    clean = "/".join(parts)
    if not path or path != clean or path.startswith("/") or ".." in parts or "\\" in path or ":" in path:
        raise BundleError(
            "bundle.path_unsafe", f"the path {path[:200]!r} leaves the bundle", "do not use this bundle"
        )
    if "\0" in path or len(path) > 1024:
        raise BundleError("bundle.path_unsafe", "a path is not printable", "do not use this bundle")


class FolderSource:
    """A bundle in a folder."""

    def __init__(self, root: Path) -> None:
        """Read from `root`; links inside it are refused, `root` itself may be one."""
        self._root = root.resolve()

    def paths(self) -> set[str]:
        """Return every file below the folder, with forward slashes."""
        names: set[str] = set()
        for entry in self._root.rglob("*"):
            mode = entry.lstat().st_mode
            name = entry.relative_to(self._root).as_posix()
            if not (stat.S_ISDIR(mode) or stat.S_ISREG(mode)):
                raise _no_plain_file(name)
            if stat.S_ISREG(mode):
                names.add(name)
            _check_count(len(names))
        return names

    def size_bytes(self, path: str) -> int:
        """Return the size of a file."""
        return (self._root / path).lstat().st_size

    def open(self, path: str) -> IO[bytes]:
        """Return an open file."""
        return (self._root / path).open("rb")


class ZipSource:
    """A bundle in one zip archive, with manifest.json at its root."""

    def __init__(self, archive: Path) -> None:
        """Read from `archive`; raises BundleError when it is not a zip archive."""
        self._path = archive
        try:
            with zipfile.ZipFile(archive) as opened:
                entries = [entry for entry in opened.infolist() if not entry.is_dir()]
        except (*_UNREADABLE, KeyError, IndexError, OverflowError) as error:
            raise BundleError(
                "bundle.archive_damaged", f'"{archive.name}" is not a readable zip archive', "fetch it again"
            ) from error
        _check_count(len(entries))
        self._entries = {entry.filename: entry for entry in entries}
        if len(entries) != len(self._entries):
            raise BundleError(
                "bundle.archive_damaged", f'"{archive.name}" holds a name twice', "do not use this bundle"
            )

    def paths(self) -> set[str]:
        """Return every file of the archive."""
        for name, entry in self._entries.items():
            check_path(name)
            mode = entry.external_attr >> 16
            if mode and stat.S_IFMT(mode) not in (0, stat.S_IFREG):
                raise _no_plain_file(name)
            if entry.flag_bits & 0x1:
                raise BundleError(
                    "bundle.encrypted", f'"{name}" is encrypted', "store the bundle unencrypted"
                )
        return set(self._entries)

    def size_bytes(self, path: str) -> int:
        """Return the size of a file once unpacked, as the archive states it."""
        return self._entries[path].file_size

    @contextmanager
    def open(self, path: str) -> Iterator[IO[bytes]]:
        """Return an open file; reading it never gives more than the stated size."""
        with zipfile.ZipFile(self._path) as opened, opened.open(self._entries[path]) as file:
            yield file


def _no_plain_file(name: str) -> BundleError:
    return BundleError(
        "bundle.not_a_plain_file", f'"{name}" is a link or a device', "replace it by the file itself"
    )


def _check_count(count: int) -> None:
    if count > MAX_FILES:
        raise BundleError("bundle.too_many_files", f"more than {MAX_FILES} files", "do not use this bundle")


def open_source(path: Path) -> FileSource:
    """Return the files of the bundle at `path`, a folder or a .zip; raises BundleError for anything else."""
    if path.is_dir():
        return FolderSource(path)
    if path.is_file():
        return ZipSource(path)
    raise BundleError("bundle.missing", f'there is no folder or file "{path}"', "check the path")


def read_checked(source: FileSource, path: str, *, limit_bytes: int) -> bytes:
    """Return a file's bytes; raises BundleError when it is damaged or above `limit_bytes`."""
    data = bytearray()
    try:
        with source.open(path) as file:
            # In blocks: a read of the limit would reserve as much memory.
            while len(data) <= limit_bytes and (block := file.read(_BLOCK)):
                data += block
    except _UNREADABLE as error:
        raise _unreadable(path) from error
    if len(data) > limit_bytes:
        raise BundleError(
            "bundle.too_large", f'"{path}" is above {limit_bytes} bytes', "do not use this bundle"
        )
    return bytes(data)


def verify(source: FileSource, path: str, size_bytes: int, sha256: str) -> None:
    """Raise BundleError unless the file has this size and this SHA-256; reads it in blocks of 1 MiB."""
    if size_bytes > MAX_FILE_BYTES:
        raise BundleError("bundle.too_large", f'"{path}" is above 4 GiB', "do not use this bundle")
    if source.size_bytes(path) != size_bytes or digest(source, path) != sha256:
        raise BundleError(
            "bundle.digest_mismatch",
            f'"{path}" is not the file the manifest describes',
            "fetch the bundle again",
        )


def digest(source: FileSource, path: str) -> str:
    """Return the SHA-256 of a file in lower-case hexadecimal, read in blocks of 1 MiB.

    Raises BundleError when it is damaged.
    """
    hasher = hashlib.sha256()
    try:
        with source.open(path) as file:
            while block := file.read(_BLOCK):
                hasher.update(block)
    except _UNREADABLE as error:
        raise _unreadable(path) from error
    return hasher.hexdigest()


def _unreadable(path: str) -> BundleError:
    return BundleError("bundle.file_damaged", f'"{path}" cannot be read', "fetch the bundle again")
