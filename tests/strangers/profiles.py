"""ICC profiles, EXIF blocks and PNG files, byte by byte: no library chooses what they say."""

import struct
import zlib

import numpy as np
from numpy import ndarray
from strangers.colours import Space, adapted, xyz_from

_D50 = np.array([0.9642, 1.0, 0.8249])
"""White of the profile connection space. Source: ICC.1:2022, 7.2.16."""
_SRGB_CURVE = (2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045)
_REC709_CURVE = (1 / 0.45, 1 / 1.099, 0.099 / 1.099, 1 / 4.5, 0.081)


def rgb_profile(space: Space, code_points: tuple[int, int] | None = None) -> bytes:
    """Return a profile (version 4) of three primaries and one curve.

    `code_points` of ITU-T H.273, of primaries and transfer, have a tag of their own (ICC.1:2022, 9.2.17).
    """
    matrix = xyz_from(space.primaries, space.white)
    matrix = adapted(matrix.sum(axis=1), _D50) @ matrix
    tags = {b"desc": _text(space.name), b"cprt": _text("none"), b"wtpt": _xyz(_D50)}
    for index, channel in enumerate("rgb"):
        tags[f"{channel}XYZ".encode()] = _xyz(matrix[:, index])
        tags[f"{channel}TRC".encode()] = _curve(space.curve)
    if code_points is not None:
        tags[b"cicp"] = b"cicp\0\0\0\0" + bytes([*code_points, 0, 1])
    return _profile(b"RGB ", tags)


def grey_profile(curve: str | float) -> bytes:
    """Return a profile of grey levels with a curve."""
    tags = {b"desc": _text("grey"), b"cprt": _text("none"), b"wtpt": _xyz(_D50), b"kTRC": _curve(curve)}
    return _profile(b"GRAY", tags)


def _profile(kind: bytes, tags: dict[bytes, bytes]) -> bytes:
    table, data = struct.pack(">I", len(tags)), b""
    start = 128 + 4 + 12 * len(tags)
    for name, content in tags.items():
        table += name + struct.pack(">II", start + len(data), len(content))
        data += content.ljust(-(-len(content) // 4) * 4, b"\0")
    head = struct.pack(">I4sI4s4s4s", start + len(data), b"\0\0\0\0", 0x04000000, b"mntr", kind, b"XYZ ")
    head += struct.pack(">6H", 2024, 1, 1, 0, 0, 0) + b"acsp" + b"\0" * 28
    head += b"".join(_fixed(value) for value in _D50)
    return head.ljust(128, b"\0") + table + data


def _curve(curve: str | float) -> bytes:
    if isinstance(curve, str):
        values = {"srgb": _SRGB_CURVE, "rec709": _REC709_CURVE}[curve]
        return b"para\0\0\0\0" + struct.pack(">HH", 3, 0) + b"".join(_fixed(value) for value in values)
    return b"para\0\0\0\0" + struct.pack(">HH", 0, 0) + _fixed(float(curve))


def _fixed(value: float) -> bytes:
    return struct.pack(">i", round(float(value) * 65536))


def _xyz(values: ndarray) -> bytes:
    return b"XYZ \0\0\0\0" + b"".join(_fixed(value) for value in values)


def _text(text: str) -> bytes:
    data = text.encode("utf-16-be")
    return b"mluc\0\0\0\0" + struct.pack(">II2s2sII", 1, 12, b"en", b"US", len(data), 28) + data


def exif(*, orientation: int = 1, colour_space: int | None = None, interoperability: str = "") -> bytes:
    """Return an EXIF block, without the word before it.

    `interoperability` "R03" with `colour_space` 0xFFFF says Adobe RGB (DCF 2.0).
    """
    first: list[tuple[int, int, int, bytes]] = [(0x0112, 3, 1, struct.pack("<HH", orientation, 0))]
    if colour_space is None:
        return b"Exif\0\0II*\0\x08\0\0\0" + _folder(first)
    inner = [(0xA001, 3, 1, struct.pack("<HH", colour_space, 0))]
    at = 8 + 2 + 12 * 2 + 4
    first.append((0x8769, 4, 1, struct.pack("<I", at)))
    block = b""
    if interoperability:
        inner.append((0xA005, 4, 1, struct.pack("<I", at + 2 + 12 * 2 + 4)))
        text = interoperability.encode() + b"\0"
        block = _folder([(1, 2, len(text), text.ljust(4, b"\0")), (2, 7, 4, b"0100")])
    return b"Exif\0\0II*\0\x08\0\0\0" + _folder(first) + _folder(inner) + block


def _folder(entries: list[tuple[int, int, int, bytes]]) -> bytes:
    rows = b"".join(struct.pack("<HHI", tag, kind, count) + value for tag, kind, count, value in entries)
    return struct.pack("<H", len(entries)) + rows + b"\0\0\0\0"


def png(levels: ndarray, *chunks: bytes, palette: bytes = b"", bits: int = 0) -> bytes:
    """Return a PNG of integer levels, height x width or height x width x 1, 2, 3, 4, with these chunks.

    With `palette` levels are its indices. `bits` packs grey levels or indices of less than 8 bits.
    """
    levels = levels[..., None] if levels.ndim == 2 else levels
    height, width, channels = levels.shape
    depth = bits or 8 * levels.dtype.itemsize
    colour = 3 if palette else {1: 0, 2: 4, 3: 2, 4: 6}[channels]
    rows = levels.astype(">u2" if depth == 16 else np.uint8).reshape(height, -1)
    if depth < 8:
        places = (rows[..., None] >> np.arange(depth)[::-1]) & 1  # highest first
        rows = np.packbits(places.reshape(height, -1).astype(np.uint8), axis=1)
    raw = b"".join(b"\0" + row.tobytes() for row in rows)
    head = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, 0))
    before = [each for each in chunks if each[4:8] != b"tRNS"]
    after = [each for each in chunks if each[4:8] == b"tRNS"]
    if palette:
        before.append(chunk(b"PLTE", palette))
    body = b"".join([head, *before, *after, chunk(b"IDAT", zlib.compress(raw)), chunk(b"IEND", b"")])
    return b"\x89PNG\r\n\x1a\n" + body


def chunk(kind: bytes, data: bytes) -> bytes:
    """Return a chunk of a PNG."""
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def iccp(profile: bytes) -> bytes:
    """Return the chunk with an ICC profile."""
    return chunk(b"iCCP", b"profile\0\0" + zlib.compress(profile))


def cicp(primaries: int, transfer: int) -> bytes:
    """Return the chunk with code points of ITU-T H.273; full range, no matrix."""
    return chunk(b"cICP", bytes([primaries, transfer, 0, 1]))


def gama(value: float) -> bytes:
    """Return the chunk that says levels are light to the power of `value`."""
    return chunk(b"gAMA", struct.pack(">I", round(100_000 * value)))


def chrm(space: Space) -> bytes:
    """Return the chunk with white and primaries of a space."""
    numbers = (*space.white, *space.primaries)
    return chunk(b"cHRM", struct.pack(">8I", *(round(100_000 * value) for value in numbers)))


def srgb() -> bytes:
    """Return the chunk that says sRGB."""
    return chunk(b"sRGB", b"\0")
