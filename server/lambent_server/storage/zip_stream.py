"""A zip archive as a stream: stored entries, whose length is known before the first byte is sent.

Local headers carry size and CRC-32, so that readers need not know data descriptors; the CRC is found by
reading an entry once before it is sent. No more than a piece of an entry is held in memory.
Source: PKWARE APPNOTE 6.3.
"""

import struct
import zlib
from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

_LOCAL = struct.Struct("<4s5H3L2H")
_CENTRAL = struct.Struct("<4s6H3L5H2L")
_END = struct.Struct("<4s4H2LH")
_VERSION = 20
# The first byte says that what follows are Unix permissions: a plain file, readable by all.
_MADE_ON_UNIX = (3 << 8) | _VERSION
_PLAIN_FILE = 0o100644 << 16
_UTF8_NAMES = 1 << 11
MAX_BYTES = 2**32 - 2
"""Of an archive; a larger one needs the ZIP64 extension."""
MAX_ENTRIES = 2**16 - 2


@dataclass(frozen=True, slots=True)
class Entry:
    """A file of an archive."""

    path: str
    size_bytes: int
    read: Callable[[], Iterator[bytes]]
    """Returns the bytes from the beginning, in pieces; called twice."""

    @property
    def name(self) -> bytes:
        """The path as the archive has it."""
        return self.path.encode("utf-8")


def length_of(entries: Sequence[Entry]) -> int:
    """Return the size of the archive in bytes."""
    each = (_LOCAL.size + _CENTRAL.size + 2 * len(entry.name) + entry.size_bytes for entry in entries)
    return sum(each) + _END.size


def fits(entries: Sequence[Entry]) -> bool:
    """Return whether the archive can be written without ZIP64."""
    return length_of(entries) <= MAX_BYTES and len(entries) <= MAX_ENTRIES


def zip_pieces(entries: Sequence[Entry], made_at: float) -> Iterator[bytes]:
    """Yield the bytes of the archive; `made_at` (Unix seconds) becomes the time of every entry, in UTC.

    Yields nothing, `b""`, for every piece that is read only for a checksum: no step takes longer than a
    piece, so that a response can be given up between any two.

    Raises OSError if an entry has another size than it should: the receiver gets too few bytes, and can
    tell from the announced length.
    """
    stamp = _dos_time(made_at)
    offset, directory = 0, []
    for entry in entries:
        crc = yield from _crc_of(entry)
        sizes = (crc, entry.size_bytes, entry.size_bytes)
        common = (_UTF8_NAMES, 0, *stamp, *sizes)
        yield _LOCAL.pack(b"PK\x03\x04", _VERSION, *common, len(entry.name), 0) + entry.name
        yield from entry.read()
        central = _CENTRAL.pack(
            b"PK\x01\x02", _MADE_ON_UNIX, _VERSION, *common, len(entry.name), 0, 0, 0, 0, _PLAIN_FILE, offset
        )
        directory.append(central + entry.name)
        offset += _LOCAL.size + len(entry.name) + entry.size_bytes
    listed = b"".join(directory)
    count = len(directory)
    yield listed + _END.pack(b"PK\x05\x06", 0, 0, count, count, len(listed), offset, 0)


def _crc_of(entry: Entry) -> Generator[bytes, None, int]:
    """Return the checksum of an entry, after yielding `b""` for each of its pieces."""
    crc, size = 0, 0
    for piece in entry.read():
        crc, size = zlib.crc32(piece, crc), size + len(piece)
        yield b""
    if size != entry.size_bytes:
        raise OSError(f"{entry.path} has {size} bytes instead of {entry.size_bytes}")
    return crc


def _dos_time(at: float) -> tuple[int, int]:
    """Return time and date as the format has them: from 1980, in steps of two seconds."""
    when = datetime.fromtimestamp(max(at, 315532800.0), UTC)
    time = (when.hour << 11) | (when.minute << 5) | (when.second // 2)
    return time, ((when.year - 1980) << 9) | (when.month << 5) | when.day
