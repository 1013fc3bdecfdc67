"""PNG files made chunk by chunk, with what Pillow does not write: cICP, gAMA, keys, 16 bits."""

import struct
import zlib

import numpy as np
from numpy import ndarray

COLOUR_TYPES = {1: 0, 2: 4, 3: 2, 4: 6}


def png_chunk(kind: bytes, data: bytes) -> bytes:
    """Return a chunk with a right checksum."""
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png_bytes(levels: ndarray, *chunks: bytes, depth: int = 8) -> bytes:
    """Return a PNG of levels [height, width, channels] with chunks before its pixels."""
    height, width, channels = levels.shape
    if depth < 8:
        bits = np.unpackbits(levels.astype(np.uint8)[..., None], axis=-1)[..., 8 - depth :]
        packed = np.packbits(bits.reshape(height, -1), axis=-1)
    else:
        packed = levels.astype(">u2" if depth == 16 else np.uint8).reshape(height, -1).view(np.uint8)
    rows = b"".join(b"\0" + row.tobytes() for row in packed)
    header = struct.pack(">IIBBBBB", width, height, depth, COLOUR_TYPES[channels], 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n"
        + png_chunk(b"IHDR", header)
        + b"".join(chunks)
        + png_chunk(b"IDAT", zlib.compress(rows))
        + png_chunk(b"IEND", b"")
    )
