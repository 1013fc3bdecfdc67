"""Reader of Radiance pictures (.hdr): shared-exponent pixels, flat or run-length coded.

The decoder is our own because the ones in picture libraries differ in what they accept and in whether
they apply EXPOSURE. A pixel (r, g, b, e) means (r, g, b) * 2^(e - 136); e = 0 is black.
"""

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lambent_relight.errors import EnvironmentFileError
from lambent_relight.picture_rows import PictureRows

_MAX_HEADER_BYTES = 1 << 16
_RESOLUTION = re.compile(rb"^([-+])Y (\d{1,7}) ([-+])X (\d{1,7})$")


def _damaged(path: Path, what: str) -> EnvironmentFileError:
    return EnvironmentFileError(
        "environment.hdr_damaged", f'"{path.name}" {what}', "export the map again as .hdr or .exr"
    )


def read_rgbe(path: Path, *, max_pixels: int) -> PictureRows:
    """Return the picture as rows of linear float32, row 0 at the top.

    Values are divided by the header's EXPOSURE (their product when there are several) and COLORCORR.
    Raises EnvironmentFileError for a damaged or truncated file, XYZ colours, rotated scan orders, and
    pictures above `max_pixels`, before their pixels are allocated.
    """
    data = path.read_bytes()
    position, scale = _read_header(path, data)
    end = data.find(b"\n", position, position + 64)
    match = _RESOLUTION.match(data[position:end]) if end > 0 else None
    if match is None:
        raise _damaged(path, "has no resolution line of the form -Y <height> +X <width>")
    height, width = int(match[2]), int(match[4])
    if height == 0 or width == 0:
        raise _damaged(path, "has no pixels")
    if height * width > max_pixels:
        raise EnvironmentFileError(
            "environment.too_large",
            f'"{path.name}" has {width} x {height} pixels, the limit is {max_pixels}',
            "reduce the map (8192 x 4096 is plenty for lighting)",
        )
    pixels = _decode(path, memoryview(data)[end + 1 :], height, width)
    if match[1] == b"+":
        pixels = pixels[::-1]
    if match[3] == b"-":
        pixels = pixels[:, ::-1]

    def rows(part: slice) -> NDArray[np.float32]:
        chosen = pixels[part]
        factor = np.ldexp(np.float32(1.0), chosen[..., 3].astype(np.int32) - 136)
        factor[chosen[..., 3] == 0] = 0.0
        return chosen[..., :3] * factor[..., None] / scale

    return PictureRows(height, width, rows)


def _read_header(path: Path, data: bytes) -> tuple[int, NDArray[np.float32]]:
    """Return where the resolution line starts, and what stored values must be divided by [3]."""
    if not data.startswith((b"#?RADIANCE", b"#?RGBE")):
        raise _damaged(path, 'does not start with "#?RADIANCE" or "#?RGBE"')
    stop = data.find(b"\n\n", 0, _MAX_HEADER_BYTES)
    if stop < 0:
        raise _damaged(path, "has no end of header within 64 KiB")
    scale = np.ones(3)
    for line in data[:stop].split(b"\n")[1:]:
        key, _, value = line.partition(b"=")
        key = key.strip()
        if key == b"FORMAT" and value.strip() != b"32-bit_rle_rgbe":
            raise EnvironmentFileError(
                "environment.hdr_format",
                f'"{path.name}" stores {value.strip()[:32].decode("ascii", "replace")}',
                "convert it to 32-bit_rle_rgbe (linear Rec. 709) or to .exr",
            )
        if key in (b"EXPOSURE", b"COLORCORR"):
            try:
                scale *= np.array([float(word) for word in value.split()])
            except ValueError as error:
                raise _damaged(path, f"has an unreadable {key.decode()} line") from error
    if not (np.isfinite(scale).all() and (scale > 0).all()):
        raise _damaged(path, "has an exposure that is not a positive number")
    return stop + 2, scale.astype(np.float32)


def _decode(path: Path, data: memoryview, height: int, width: int) -> NDArray[np.uint8]:
    coded = 8 <= width <= 32767 and len(data) >= 4 and data[0] == 2 and data[1] == 2 and data[2] < 128
    if not coded:
        return _decode_flat(path, data, height, width)
    planes = np.empty((height, 4, width), np.uint8)
    position = 0
    for row in range(height):
        head = bytes(data[position : position + 4])
        if len(head) < 4 or head[:2] != b"\x02\x02" or (head[2] << 8 | head[3]) != width:
            raise _damaged(path, f"is damaged or ends early at row {row}")
        line, position = _decode_row(path, data, position + 4, 4 * width, row)
        planes[row] = np.frombuffer(line, np.uint8).reshape(4, width)
    return planes.transpose(0, 2, 1)


def _decode_row(path: Path, data: memoryview, position: int, size: int, row: int) -> tuple[bytearray, int]:
    """Return `size` bytes of run-length coded data and the position behind them."""
    line = bytearray()
    end = len(data)
    while len(line) < size:
        if position + 1 >= end:
            raise _damaged(path, f"ends early at row {row}")
        count = data[position]
        if count > 128:
            line += bytes((data[position + 1],)) * (count - 128)
            position += 2
        else:
            line += data[position + 1 : position + 1 + count]
            position += 1 + count
        if count == 0 or position > end:
            raise _damaged(path, f"is damaged at row {row}")
    if len(line) != size:
        raise _damaged(path, f"has a run over the end of row {row}")
    return line, position


def _decode_flat(path: Path, data: memoryview, height: int, width: int) -> NDArray[np.uint8]:
    """Return pixels stored one after another, with the old format's (1, 1, 1, n) repeats if there are any."""
    pixels = np.frombuffer(data[: len(data) // 4 * 4], np.uint8).reshape(-1, 4)
    repeats = (pixels[:, :3] == 1).all(axis=1)
    if not repeats.any():
        if len(pixels) < height * width:
            raise _damaged(path, f"has {len(pixels)} of {height * width} pixels")
        return pixels[: height * width].reshape(height, width, 4)
    # Consecutive repeats are digits of one count, least significant first.
    counts = np.ones(len(pixels), np.int64)
    digit = 0
    for index in np.flatnonzero(repeats):
        digit = digit + 1 if index > 0 and repeats[index - 1] else 0
        if index == 0 or digit > 3:
            raise _damaged(path, "repeats a pixel that is not there")
        counts[index] = int(pixels[index, 3]) << (8 * digit)
    if counts.sum() < height * width:
        raise _damaged(path, f"has {counts.sum()} of {height * width} pixels")
    source = np.maximum.accumulate(np.where(repeats, 0, np.arange(len(pixels))))
    ends = np.cumsum(counts)
    index = np.searchsorted(ends, np.arange(height * width), side="right")
    return pixels[source[index]].reshape(height, width, 4)
