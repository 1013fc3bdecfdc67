"""OpenEXR pictures: reading untrusted environment maps, writing results.

The headers of all parts are judged before pixels are read, because a file of a few hundred bytes can ask
for gigabytes, and the library decodes all parts or none. Source: docs/reference/conventions.md (colour).
"""

from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
from numpy.typing import NDArray

from lambent_relight.errors import EnvironmentFileError
from lambent_relight.picture_rows import PictureRows

REC709_CHROMATICITIES = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)
"""Red, green, blue and white of linear Rec. 709, CIE x and y each."""


def _unusable(code: str, path: Path, what: str, advice: str) -> EnvironmentFileError:
    return EnvironmentFileError(code, f'"{path.name}" {what}', advice)


@contextmanager
def _refusing_damage(path: Path) -> Iterator[None]:
    # Damaged files make the library raise anything, in headers it has read as well as while it reads.
    try:
        yield
    except EnvironmentFileError:
        raise
    except Exception as error:
        raise _damaged(path) from error


def read_exr_parts(path: Path, *, max_pixels: int) -> list[OpenEXR.Part]:
    """Return the parts of a file with their headers and channels, each channel by its own name.

    Raises EnvironmentFileError for a damaged file, one with a deep part, and one whose parts together hold
    more than four channels of `max_pixels`, before anything is decoded.
    """
    with _refusing_damage(path):
        headers = [part.header for part in OpenEXR.File(str(path), header_only=True).parts]
        for header in headers:
            width, height = _size(header["dataWindow"])
            if header.get("type") in (OpenEXR.deepscanline, OpenEXR.deeptile):
                raise _unusable("environment.exr_deep", path, "holds a deep picture", "flatten it")
            if width <= 0 or height <= 0:
                raise _damaged(path)
            if width * height > max_pixels:
                raise _unusable(
                    "environment.too_large",
                    path,
                    f"has {width} x {height} pixels, the limit is {max_pixels}",
                    "reduce the map (8192 x 4096 is plenty for lighting)",
                )
        values = sum(np.prod(_size(header["dataWindow"])) * len(header["channels"]) for header in headers)
        if values > 4 * max_pixels:
            raise _unusable(
                "environment.too_large",
                path,
                f"holds {values} values in all its channels, the limit is {4 * max_pixels}",
                "save the map as RGB alone",
            )
        parts = OpenEXR.File(str(path), separate_channels=True, num_threads=1).parts
    # The library returns fewer parts, and no exception, when it runs out of memory.
    if not headers or len(parts) < len(headers):
        raise _damaged(path)
    return parts


def read_exr_rgb(path: Path, *, max_pixels: int) -> PictureRows:
    """Return the R, G, B channels as rows of linear float32, row 0 at the top.

    Half and float channels are read, from the first part that has all three; alpha is ignored (EXR
    colours are already multiplied by it). Raises EnvironmentFileError for what `read_exr_parts` refuses, a
    file without colour, one in other primaries than Rec. 709 and a cropped picture.
    """
    parts = read_exr_parts(path, max_pixels=max_pixels)
    with _refusing_damage(path):
        part = _colour_part(path, parts)
        width, height = _checked_size(path, part.header)
        _check_colour(path, part.header)
        planes = [part.channels[name].pixels for name in "RGB"]
    if any(p is None or p.shape != (height, width) for p in planes):
        raise _damaged(path)
    if any(plane.dtype not in (np.float16, np.float32) for plane in planes):
        raise _unusable(
            "environment.exr_channels", path, "stores colour as integers", "save it as half or float"
        )

    def rows(part: slice) -> NDArray[np.float32]:
        return np.stack([plane[part].astype(np.float32) for plane in planes], axis=-1)

    return PictureRows(height, width, rows)


def _damaged(path: Path) -> EnvironmentFileError:
    return _unusable(
        "environment.exr_damaged",
        path,
        "cannot be decoded as OpenEXR (damaged, or more than the memory there is)",
        "export the map again as .exr or .hdr, or reduce it",
    )


def _colour_part(path: Path, parts: list[OpenEXR.Part]) -> OpenEXR.Part:
    for part in parts:
        if {"R", "G", "B"} <= set(part.channels):
            return part
    found = sorted(name for part in parts for name in part.channels)
    raise _unusable(
        "environment.exr_channels",
        path,
        f"has the channels {found[:16]}, expected R, G and B in one part",
        "save the map as RGB or RGBA",
    )


def _size(window: tuple) -> tuple[int, int]:
    (x0, y0), (x1, y1) = ([int(v) for v in corner] for corner in window)
    return x1 - x0 + 1, y1 - y0 + 1


def _checked_size(path: Path, header: dict) -> tuple[int, int]:
    stored, whole = _size(header["dataWindow"]), _size(header["displayWindow"])
    if stored != whole:
        raise _unusable(
            "environment.exr_cropped",
            path,
            f"stores {stored[0]} x {stored[1]} of {whole[0]} x {whole[1]} pixels",
            "save the whole picture (data window equal to display window)",
        )
    return stored


def _check_colour(path: Path, header: dict) -> None:
    stated = header.get("chromaticities")
    if stated is not None and not np.allclose(np.ravel(stated), REC709_CHROMATICITIES, atol=2e-3):
        raise _unusable(
            "environment.exr_primaries",
            path,
            f"states the primaries {np.round(np.ravel(stated), 4).tolist()}, expected Rec. 709",
            "convert the map to linear Rec. 709 (sRGB primaries)",
        )


def write_exr(
    path: Path,
    channels: Mapping[str, NDArray[np.floating]],
    *,
    half: bool = True,
    full_precision: Collection[str] = (),
    attributes: Mapping[str, Any] | None = None,
) -> None:
    """Write named channels [height, width] of one size as a scan-line EXR, ZIP compressed.

    The file states linear Rec. 709 primaries. With `half`, values are clamped to what half floats
    hold (65504) instead of becoming infinite; channels named in `full_precision` are 32-bit floats anyway.
    """
    header = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "chromaticities": REC709_CHROMATICITIES,
        **(attributes or {}),
    }
    planes = {}
    for name, plane in channels.items():
        dtype = np.float16 if half and name not in full_precision else np.float32
        limit = float(np.finfo(dtype).max)
        planes[name] = np.ascontiguousarray(np.clip(plane, -limit, limit), dtype)
    path.parent.mkdir(parents=True, exist_ok=True)
    OpenEXR.File(header, planes).write(str(path))
