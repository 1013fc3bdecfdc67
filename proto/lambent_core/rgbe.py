"""Reader of Radiance pictures (.hdr): shared-exponent pixels, flat or run-length coded.

The decoder is our own because the ones in picture libraries differ in what they accept and in whether
they apply EXPOSURE and PRIMARIES. A pixel (r, g, b, e) means (r, g, b) * 2^(e - 136); e = 0 is black.
"""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lambent_core.colour import rec709_matrix, to_rec709
from lambent_core.errors import EnvironmentFileError
from lambent_core.picture_rows import PictureRows
from lambent_core.rgbe_rows import DamagedLinesError, decode_lines

_MAX_HEADER_BYTES = 1 << 16
_RESOLUTION = re.compile(rb"^([-+])([XY]) (\d{1,7}) ([-+])([XY]) (\d{1,7})$")


@dataclass(frozen=True, slots=True)
class _Header:
    end: int
    """Where the resolution line starts."""
    scale: NDArray[np.float32]
    """What stored values must be divided by, [3]."""
    matrix: NDArray[np.float32] | None
    """From the stated primaries to Rec. 709."""


def _damaged(path: Path, what: str) -> EnvironmentFileError:
    return EnvironmentFileError(
        "environment.hdr_damaged", f'"{path.name}" {what}', "export the map again as .hdr or .exr"
    )


def read_rgbe(path: Path, *, max_pixels: int) -> PictureRows:
    """Return the picture as rows of linear float32 Rec. 709, row 0 at the top, whatever its scan order.

    Values are divided by the header's EXPOSURE (their product when there are several) and COLORCORR, and
    converted from the PRIMARIES that it states. Raises EnvironmentFileError for a damaged or truncated file,
    XYZ colours, and pictures above `max_pixels`, before their pixels are allocated.
    """
    data = path.read_bytes()
    header = _read_header(path, data)
    end = data.find(b"\n", header.end, header.end + 64)
    match = _RESOLUTION.match(data[header.end : end]) if end > 0 else None
    if match is None or match[2] == match[5]:
        raise _damaged(path, "has no resolution line of the form -Y <height> +X <width>")
    lines, length = int(match[3]), int(match[6])
    by_columns = match[2] == b"X"
    height, width = (length, lines) if by_columns else (lines, length)
    if height == 0 or width == 0:
        raise _damaged(path, "has no pixels")
    if height * width > max_pixels:
        raise EnvironmentFileError(
            "environment.too_large",
            f'"{path.name}" has {width} x {height} pixels, the limit is {max_pixels}',
            "reduce the map (8192 x 4096 is plenty for lighting)",
        )
    try:
        pixels = decode_lines(memoryview(data)[end + 1 :], lines, length)
    except DamagedLinesError as error:
        raise _damaged(path, str(error)) from error
    signs = {match[2]: match[1], match[5]: match[4]}
    if by_columns:
        pixels = pixels.transpose(1, 0, 2)
    if signs[b"Y"] == b"+":
        pixels = pixels[::-1]
    if signs[b"X"] == b"-":
        pixels = pixels[:, ::-1]

    def rows(part: slice) -> NDArray[np.float32]:
        chosen = pixels[part]
        factor = np.ldexp(np.float32(1.0), chosen[..., 3].astype(np.int32) - 136)
        factor[chosen[..., 3] == 0] = 0.0
        linear = chosen[..., :3] * factor[..., None] / header.scale
        return to_rec709(linear.astype(np.float32, copy=False), header.matrix)

    return PictureRows(height, width, rows)


def _read_header(path: Path, data: bytes) -> _Header:
    if not data.startswith((b"#?RADIANCE", b"#?RGBE")):
        raise _damaged(path, 'does not start with "#?RADIANCE" or "#?RGBE"')
    stop = data.find(b"\n\n", 0, _MAX_HEADER_BYTES)
    if stop < 0:
        raise _damaged(path, "has no end of header within 64 KiB")
    scale, matrix = np.ones(3), None
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
        if key == b"PRIMARIES":
            try:
                matrix = rec709_matrix([float(word) for word in value.split()])
            except ValueError as error:
                raise _damaged(path, f"has an unusable PRIMARIES line ({error})") from error
    if not (np.isfinite(scale).all() and (scale > 0).all()):
        raise _damaged(path, "has an exposure that is not a positive number")
    return _Header(stop + 2, scale.astype(np.float32), matrix)
