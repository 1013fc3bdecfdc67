"""Files whose headers announce more data than they contain."""

import struct
import zlib
from pathlib import Path


def huge_png(path: Path, side: int) -> None:
    """Write a valid PNG header that promises side x side pixels, and almost no data."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", side, side, 8, 6, 0, 0, 0)
    path.write_bytes(
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", header)
        + chunk(b"IDAT", zlib.compress(b"\0"))
        + chunk(b"IEND", b"")
    )


def huge_exr(path: Path, side: int) -> None:
    """Write the first bytes of an EXR file that asks for side x side pixels."""
    box = struct.pack("<iiii", 0, 0, side - 1, side - 1)
    path.write_bytes(
        b"\x76\x2f\x31\x01\x02\0\0\0" + b"dataWindow\0box2i\0" + struct.pack("<i", 16) + box + b"\0" * 300
    )
