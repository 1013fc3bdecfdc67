"""Opens camera raw files through rawpy (LibRaw), the extra `raw`, as linear Rec. 709 colours.

Every 2 x 2 cell of the sensor becomes one pixel: nothing is interpolated, and the halved side still exceeds
what any preset trains on. Pixels stay as the sensor has them; the orientation in the file is not applied.

White balance is LibRaw's daylight one, which depends on the camera's model alone. The balance that the camera
chose may differ from photograph to photograph, and following it would change the colour of the object from
view to view. What remains is one factor per channel for the whole capture, which light and albedo share
anyway. For the same reason neither brightness nor white level is fitted to the picture.
"""

import importlib
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32
from lambent_core.errors import pip_install
from numpy import ndarray

from lambent_capture.arrays import Colours32
from lambent_capture.pictures.picture_error import PictureError, reason_of

_STACKED = "Stack"
"""Name of LibRaw's kind of file that has all colours at each pixel; it is halved by us."""


def raw_available() -> bool:
    """Return whether rawpy is installed."""
    return find_spec("rawpy") is not None


def raw_picture_size(path: Path) -> tuple[int, int]:
    """Return width and height in pixels that `raw_pixels` gives, from the header.

    Raises `PictureError` for a missing file, one that is not a raw file, and where rawpy is not installed.
    """
    with _opened(path) as raw:
        sizes = raw.sizes
        return (sizes.width + 1) // 2, (sizes.height + 1) // 2


def raw_pixels(path: Path) -> Colours32:
    """Return linear Rec. 709 colours in 0..1, where 1 is the end of the sensor's scale.

    Raises `PictureError` as `raw_picture_size` does, and for pixels that cannot be decoded.
    """
    rawpy = _library(path)
    with _opened(path) as raw:
        expected = ((raw.sizes.height + 1) // 2, (raw.sizes.width + 1) // 2)
        try:
            levels = raw.postprocess(
                half_size=True,
                gamma=(1.0, 1.0),
                output_bps=16,
                output_color=rawpy.ColorSpace.sRGB,
                user_flip=0,
                no_auto_bright=True,
                adjust_maximum_thr=0.0,
                highlight_mode=rawpy.HighlightMode.Clip,
            )
            stacked = raw.raw_type.name == _STACKED
        except rawpy.LibRawError as error:
            raise _broken(error) from error
    colours = levels.astype(np.float32)
    colours *= np.float32(1.0 / 65535.0)
    if stacked:
        colours = _halved(colours)
    if colours.shape != (*expected, 3):
        raise PictureError(
            "scene.raw_unsupported",
            f"is a raw file with pixels of a kind that is not understood ({colours.shape[1]} x "
            f"{colours.shape[0]} instead of {expected[1]} x {expected[0]}); develop it to JPEG or PNG",
        )
    return colours


def raw_settings(path: Path) -> dict[str, Any]:
    """Return what LibRaw knows about how a raw file was taken: `other` and `lens` of rawpy, as plain values.

    Raises `PictureError` as `raw_picture_size` does.
    """
    rawpy = _library(path)
    with _opened(path) as raw:
        try:
            other, lens = raw.other, raw.lens
            sizes = raw.sizes
        except rawpy.LibRawError as error:
            raise _broken(error) from error
    return {
        "time_s": float(other.shutter_speed),
        "f_number": float(other.aperture),
        "iso": float(other.iso_speed),
        "focal_mm": float(other.focal_length),
        "taken": other.timestamp,
        "lens": " ".join(word for word in (lens.make, lens.model) if word),
        "flip": int(sizes.flip),
    }


def _opened(path: Path) -> Any:
    """Return rawpy's object for a file, its header read; a context manager."""
    if not path.is_file():
        raise PictureError("scene.file_missing", "does not exist; add it or remove the frame")
    rawpy = _library(path)
    try:
        return rawpy.imread(str(path))
    except rawpy.LibRawError as error:
        raise PictureError(
            "scene.image_not_a_picture",
            f"is not a camera raw file that LibRaw knows ({_said(error)}); copy it again, or develop it to "
            "JPEG with the camera's program",
        ) from error


def _library(path: Path) -> Any:
    if not raw_available():
        raise PictureError(
            "scene.raw_not_installed",
            f"is a camera raw file ({path.suffix}), and rawpy, which reads them, is not installed; run "
            f"{pip_install('raw')}, or export the photographs as JPEG",
        )
    return importlib.import_module("rawpy")


def _broken(error: Exception) -> PictureError:
    return PictureError(
        "scene.image_broken",
        f"cannot be developed ({_said(error)}); copy it again, or export it as JPEG",
    )


def _said(error: Exception) -> str:
    said = error.args[0] if error.args else ""
    return said.decode(errors="replace") if isinstance(said, bytes) else reason_of(error)


def _halved(colours: Float32[ndarray, "rows columns 3"]) -> Colours32:
    """Return the mean of each 2 x 2 pixels; a last odd row or column counts twice."""
    padded = np.pad(colours, ((0, colours.shape[0] % 2), (0, colours.shape[1] % 2), (0, 0)), mode="edge")
    rows = 0.5 * (padded[0::2] + padded[1::2])
    return np.ascontiguousarray(0.5 * (rows[:, 0::2] + rows[:, 1::2]))
