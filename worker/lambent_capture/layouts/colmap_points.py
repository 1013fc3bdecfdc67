"""Reads the points of a COLMAP sparse model, as text or binary; the file is untrusted."""

import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float64
from numpy import ndarray

from lambent_capture.arrays import Points64
from lambent_capture.layouts.colmap_model import ModelError, open_text

_POINT = struct.Struct("<Q3d3Bd")
_COUNT = struct.Struct("<Q")
_SIGHTING_BYTES = 8
MAX_BYTES = 2**31


@dataclass(frozen=True, slots=True)
class ColmapPoints:
    """Points of a sparse model."""

    xyz: Points64
    """In the model's world."""
    images: tuple[frozenset[int], ...]
    """For each point the numbers of the images that see it."""
    error: Float64[ndarray, " points"]
    """Mean distance of each point from where it is seen, pixels."""


def read_points(folder: Path) -> ColmapPoints | None:
    """Return the points of the model in `folder`, or None where it has no file of them.

    Raises `ModelError` for a file that is cut off or holds something else.
    """
    binary, text = folder / "points3D.bin", folder / "points3D.txt"
    if binary.is_file():
        return _from_binary(binary)
    return _from_text(text) if text.is_file() else None


def _from_binary(path: Path) -> ColmapPoints:
    if path.stat().st_size > MAX_BYTES:
        raise ModelError(f"has more than {MAX_BYTES} bytes")
    data = path.read_bytes()
    xyz, errors, images = [], [], []
    try:
        (count,) = _COUNT.unpack_from(data)
        at = _COUNT.size
        for _ in range(count):
            _, x, y, z, *_, error = _POINT.unpack_from(data, at)
            xyz.append((x, y, z))
            errors.append(error)
            (length,) = _COUNT.unpack_from(data, at + _POINT.size)
            at += _POINT.size + _COUNT.size
            sightings = np.frombuffer(data, dtype="<u4", count=2 * length, offset=at)
            images.append(frozenset(sightings[::2].tolist()))
            at += _SIGHTING_BYTES * length
    except (struct.error, ValueError, OverflowError) as problem:
        raise ModelError("is cut off") from problem
    if at != len(data):
        raise ModelError("continues after its last point")
    return _checked(np.array(xyz).reshape(-1, 3), np.array(errors), images)


def _from_text(path: Path) -> ColmapPoints:
    xyz, errors, images = [], [], []
    with open_text(path, errors="replace") as file:
        for line in file:
            values = line.split()
            if not values or values[0].startswith("#"):
                continue
            try:
                xyz.append([float(value) for value in values[1:4]])
                errors.append(float(values[7]))
                images.append(frozenset(int(value) for value in values[8::2]))
            except (ValueError, IndexError) as error:
                raise ModelError(f"has a line that is not a point: {line[:60]!r}") from error
    if any(len(point) != 3 for point in xyz):
        raise ModelError("has a point without three coordinates")
    return _checked(np.array(xyz).reshape(-1, 3), np.array(errors), images)


def _checked(xyz: Points64, error: Float64[ndarray, " points"], images: list[frozenset[int]]) -> ColmapPoints:
    if not np.isfinite(xyz).all():
        raise ModelError("has points that are not finite")
    return ColmapPoints(xyz, tuple(images), error)
