"""Camera raw files: the smallest DNG that a raw converter takes for a photograph."""

import struct
from pathlib import Path

import numpy as np
from numpy import ndarray

WHITE = 16383
BLACK = 512
# XYZ (D65) to linear sRGB: a camera whose filters are the primaries of sRGB.
SRGB_FROM_XYZ = (3.2404542, -1.5371385, -0.4985314, -0.9692660, 1.8760108, 0.0415560, 0.0556434, -0.2040259)
SRGB_FROM_XYZ = (*SRGB_FROM_XYZ, 1.0572252)
BYTE, ASCII, SHORT, LONG, RATIONAL, SIGNED_RATIONAL = 1, 2, 3, 4, 5, 10
_SIZES = {BYTE: 1, ASCII: 1, SHORT: 2, LONG: 4, RATIONAL: 8, SIGNED_RATIONAL: 8}


def bayer(linear: ndarray) -> ndarray:
    """Return the mosaic [height, width] that an RGGB sensor records of linear colours [height, width, 3]."""
    mosaic = linear[..., 1].copy()
    mosaic[0::2, 0::2] = linear[0::2, 0::2, 0]
    mosaic[1::2, 1::2] = linear[1::2, 1::2, 2]
    return np.round(BLACK + mosaic.clip(0.0, 1.0) * (WHITE - BLACK)).astype("<u2")


def write_dng(
    path: Path,
    linear: ndarray,
    *,
    orientation: int = 1,
    neutral: tuple[float, float, float] = (1.0, 1.0, 1.0),
    exposure: tuple[float, float, int] = (0.01, 8.0, 100),
) -> None:
    """Write a DNG of linear sRGB colours [height, width, 3] in 0..1, with even height and width.

    `neutral` is what the camera took for grey; `exposure` is time in seconds, f-number and ISO.
    """
    height, width = linear.shape[:2]
    pixels = bayer(linear).tobytes()
    time_s, f_number, iso = exposure
    exif = _folder(
        [
            (0x829A, RATIONAL, [time_s]),
            (0x829D, RATIONAL, [f_number]),
            (0x8827, SHORT, [iso]),
            (0x920A, RATIONAL, [26.0]),
            (0xA405, SHORT, [39]),
        ],
        start=8,
    )
    strip = 8 + len(exif)
    entries = [
        (0x00FE, LONG, [0]),
        (0x0100, LONG, [width]),
        (0x0101, LONG, [height]),
        (0x0102, SHORT, [16]),
        (0x0103, SHORT, [1]),
        (0x0106, SHORT, [32803]),
        (0x010F, ASCII, b"Lambent\0"),
        (0x0110, ASCII, b"Test camera\0"),
        (0x0111, LONG, [strip]),
        (0x0112, SHORT, [orientation]),
        (0x0115, SHORT, [1]),
        (0x0116, LONG, [height]),
        (0x0117, LONG, [len(pixels)]),
        (0x011C, SHORT, [1]),
        (0x828D, SHORT, [2, 2]),
        (0x828E, BYTE, bytes([0, 1, 1, 2])),
        (0x8769, LONG, [8]),
        (0xC612, BYTE, bytes([1, 4, 0, 0])),
        (0xC614, ASCII, b"Lambent Test camera\0"),
        (0xC61A, SHORT, [BLACK]),
        (0xC61D, SHORT, [WHITE]),
        (0xC621, SIGNED_RATIONAL, SRGB_FROM_XYZ),
        (0xC628, RATIONAL, neutral),
        (0xC65A, SHORT, [21]),
    ]
    first = strip + len(pixels)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(b"II*\0" + struct.pack("<I", first) + exif + pixels + _folder(entries, start=first))


def _folder(entries: list, start: int) -> bytes:
    """Return a TIFF directory that begins `start` bytes into the file, with its values behind it."""
    head = struct.pack("<H", len(entries))
    behind = b""
    free = start + 2 + 12 * len(entries) + 4
    for tag, kind, values in entries:
        data = _encoded(kind, values)
        count = len(data) // _SIZES[kind]
        if len(data) <= 4:
            field = data.ljust(4, b"\0")
        else:
            field = struct.pack("<I", free + len(behind))
            behind += data + b"\0" * (len(data) % 2)
        head += struct.pack("<HHI", tag, kind, count) + field
    return head + b"\0\0\0\0" + behind


def _encoded(kind: int, values: object) -> bytes:
    if isinstance(values, bytes):
        return values
    if kind in (RATIONAL, SIGNED_RATIONAL):
        return b"".join(struct.pack("<ii", round(value * 1e6), 10**6) for value in values)
    return struct.pack(f"<{len(values)}{'H' if kind == SHORT else 'I'}", *values)
