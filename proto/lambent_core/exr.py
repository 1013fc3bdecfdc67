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

from lambent_core.colour import REC709_CHROMATICITIES, rec709_matrix, to_rec709
from lambent_core.errors import EnvironmentFileError
from lambent_core.picture_rows import PictureRows

__all__ = ["REC709_CHROMATICITIES", "read_exr_parts", "read_exr_rgb", "write_exr"]


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
    """Return the R, G, B channels as rows of linear float32 Rec. 709, row 0 at the top of the display window.

    Half and float channels are read, from the first part that has all three, and converted from the stated
    chromaticities; alpha is ignored (EXR colours are already multiplied by it). `layout` is "cube" where the
    attribute envmap says so. Raises EnvironmentFileError for what `read_exr_parts` refuses, a file without
    colour, with integers or subsampled colours, and a picture that does not fill its display window.
    """
    parts = read_exr_parts(path, max_pixels=max_pixels)
    with _refusing_damage(path):
        part = _colour_part(path, parts)
        (left, top), (width, height) = _shown(path, part.header)
        matrix = _matrix(path, part.header)
        if any((part.channels[name].xSampling, part.channels[name].ySampling) != (1, 1) for name in "RGB"):
            raise _unusable(
                "environment.exr_channels", path, "stores colour subsampled", "save it at full resolution"
            )
        planes = [part.channels[name].pixels for name in "RGB"]
        layout = {OpenEXR.ENVMAP_CUBE: "cube", OpenEXR.ENVMAP_LATLONG: "latlong"}.get(
            part.header.get("envmap")
        )
        stored = tuple(reversed(_size(part.header["dataWindow"])))
    if any(p is None or p.shape != stored for p in planes):
        raise _damaged(path)
    if any(plane.dtype not in (np.float16, np.float32) for plane in planes):
        raise _unusable(
            "environment.exr_channels", path, "stores colour as integers", "save it as half or float"
        )
    planes = [plane[top : top + height, left : left + width] for plane in planes]

    def rows(part: slice) -> NDArray[np.float32]:
        return to_rec709(np.stack([plane[part].astype(np.float32) for plane in planes], axis=-1), matrix)

    return PictureRows(height, width, rows, layout)


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
    names = sorted(name for part in parts for name in part.channels)
    raise _unusable(
        "environment.exr_channels",
        path,
        f"has the channels {names[:16]}, expected R, G and B in one part",
        "save the map as RGB or RGBA",
    )


def _size(window: tuple) -> tuple[int, int]:
    (x0, y0), (x1, y1) = ([int(v) for v in corner] for corner in window)
    return x1 - x0 + 1, y1 - y0 + 1


def _shown(path: Path, header: dict) -> tuple[tuple[int, int], tuple[int, int]]:
    """Return where the display window begins in the stored pixels (column, row), and its width and height."""
    stored, whole = _size(header["dataWindow"]), _size(header["displayWindow"])
    begin = [int(v) for v in np.subtract(header["displayWindow"][0], header["dataWindow"][0])]
    room = [a - b - c for a, b, c in zip(stored, whole, begin, strict=True)]
    if min(*begin, *room) < 0 or min(whole) <= 0:
        raise _unusable(
            "environment.exr_cropped",
            path,
            f"stores {stored[0]} x {stored[1]} pixels, its picture is {whole[0]} x {whole[1]} from column "
            f"{begin[0]} and row {begin[1]} of them",
            "save the whole picture (data window equal to display window)",
        )
    return (begin[0], begin[1]), whole


def _matrix(path: Path, header: dict) -> NDArray[np.float32] | None:
    stated = header.get("chromaticities")
    if stated is None:
        return None
    try:
        return rec709_matrix(stated)
    except ValueError as error:
        raise _unusable(
            "environment.exr_primaries",
            path,
            f"states the primaries {np.round(np.ravel(stated), 4).tolist()}, which cannot be ({error})",
            "export the map again as linear Rec. 709 (sRGB primaries)",
        ) from error


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
