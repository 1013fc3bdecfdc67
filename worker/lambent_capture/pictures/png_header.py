"""Chunks of a PNG that Pillow does not show. Source: W3C PNG specification, 3rd edition."""

import struct
from dataclasses import dataclass
from pathlib import Path

_MOST_CHUNKS = 10_000
_MOST_PIECES, _MOST_EXIF = 200_000, 2**20
_KEPT = (b"IHDR", b"tRNS", b"cICP", b"sRGB", b"gAMA", b"cHRM")


@dataclass(frozen=True, kw_only=True, slots=True)
class PngHeader:
    """What a PNG says before its pixels."""

    bit_depth: int
    """Bits of a channel: 1, 2, 4, 8 or 16."""
    colour_type: int
    """0 grey, 2 colours, 3 palette, 4 grey with alpha, 6 colours with alpha."""
    key: tuple[int, ...]
    """The levels that stand for "transparent" in a picture without alpha, at its bit depth; may be empty."""
    code_points: tuple[int, ...]
    """Primaries, transfer, matrix and range of cICP; may be empty."""
    is_srgb: bool
    gamma: float
    """Exponent from light to levels; 0 where not stated."""
    chromaticities: tuple[float, ...] | None
    """x and y of white, red, green, blue."""


def late_exif(path: Path) -> bytes:
    """Return the eXIf chunk behind the pixels, or nothing; the pixels are passed over, not decoded."""
    with path.open("rb") as file:
        file.seek(8)
        for _ in range(_MOST_PIECES):
            start = file.read(8)
            if len(start) < 8 or start[4:] == b"IEND":
                break
            length = int.from_bytes(start[:4], "big")
            if start[4:] == b"eXIf":
                return file.read(length) if length <= _MOST_EXIF else b""
            file.seek(length + 4, 1)
    return b""


def png_header(path: Path) -> PngHeader:
    """Return what the chunks before the pixels say; raises ValueError for a file that is not a PNG."""
    chunks: dict[bytes, bytes] = {}
    with path.open("rb") as file:
        file.seek(8)
        for _ in range(_MOST_CHUNKS):
            start = file.read(8)
            if len(start) < 8 or start[4:] in (b"IDAT", b"IEND"):
                break
            length, kind = int.from_bytes(start[:4], "big"), start[4:]
            if kind in _KEPT and length <= 1024:
                chunks.setdefault(kind, file.read(length))
                file.seek(4, 1)
            else:
                file.seek(length + 4, 1)
    header = chunks.get(b"IHDR", b"")
    if len(header) != 13:
        raise ValueError("no header")
    depth, colour_type = header[8], header[9]
    gamma, corners, key = chunks.get(b"gAMA", b""), chunks.get(b"cHRM", b""), chunks.get(b"tRNS", b"")
    channels = {0: 1, 2: 3}.get(colour_type, 0)
    return PngHeader(
        bit_depth=depth,
        colour_type=colour_type,
        key=struct.unpack(f">{channels}H", key) if channels and len(key) == 2 * channels else (),
        code_points=tuple(chunks.get(b"cICP", b""))[:4],
        is_srgb=b"sRGB" in chunks,
        gamma=int.from_bytes(gamma, "big") / 100_000 if len(gamma) == 4 else 0.0,
        chromaticities=tuple(value / 100_000 for value in struct.unpack(">8I", corners))
        if len(corners) == 32
        else None,
    )
