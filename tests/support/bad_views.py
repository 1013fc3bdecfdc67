"""Captures whose photographs are sound one by one, and that only show to be bad when cameras are solved.

Hook for tests of the solver: `write_needing_cameras(name, folder, photographs)` for each of `NEED_CAMERAS`.
"""

from pathlib import Path

import numpy as np
from numpy import ndarray
from PIL import Image
from scipy import ndimage
from support.photographs import view

NEED_CAMERAS = ("mirrored", "two objects", "fisheye without EXIF", "rolling shutter", "unrelated photographs")


def write_needing_cameras(name: str, folder: Path, photographs: list[Path]) -> None:
    """Write one of `NEED_CAMERAS`, made from sound photographs of one object.

    "two objects" and "unrelated photographs" take the second half of them from the texture of this module.
    """
    folder.mkdir(parents=True)
    for index, path in enumerate(sorted(photographs)):
        with Image.open(path) as image:
            pixels = np.asarray(image.convert("RGB"))
        foreign = np.asarray(view(index, pixels.shape[1], pixels.shape[0]))
        if name == "mirrored":
            pixels = pixels[:, ::-1] if index % 2 else pixels
        elif name == "two objects":
            pixels = foreign if index >= len(photographs) // 2 else pixels
        elif name == "unrelated photographs":
            pixels = foreign
        elif name == "fisheye without EXIF":
            pixels = _as_fisheye(pixels)
        elif name == "rolling shutter":
            pixels = _sheared(pixels, 0.12 if index % 2 else -0.12)
        else:
            raise KeyError(name)
        Image.fromarray(np.ascontiguousarray(pixels)).save(folder / f"{index:03d}.jpg", quality=92)


def _as_fisheye(pixels: ndarray) -> ndarray:
    """Return the picture that an equidistant lens of 150 degrees makes of a photograph of 75 degrees."""
    height, width = pixels.shape[:2]
    rows, columns = np.mgrid[:height, :width].astype(np.float64)
    across, down = columns - 0.5 * width, rows - 0.5 * height
    radius = np.hypot(across, down) / (0.5 * width)
    factor = (
        np.tan(np.minimum(radius * np.radians(37.5), 1.3))
        / np.tan(np.radians(37.5))
        / np.maximum(radius, 1e-6)
    )
    places = (down * factor + 0.5 * height, across * factor + 0.5 * width)
    planes = [ndimage.map_coordinates(pixels[..., c], places, order=1, mode="nearest") for c in range(3)]
    return np.stack(planes, axis=-1)


def _sheared(pixels: ndarray, slope: float) -> ndarray:
    """Return the picture of a shutter that moves down while the camera moves sideways."""
    rows = np.arange(pixels.shape[0])
    shift = np.round(slope * (rows - 0.5 * len(rows))).astype(int)
    columns = (np.arange(pixels.shape[1])[None] + shift[:, None]).clip(0, pixels.shape[1] - 1)
    return pixels[rows[:, None], columns]
