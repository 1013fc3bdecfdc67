"""Facts about photographs that help to find their cameras: size, lens, zoom, and which way was up.

Everything is about the pixels as the file stores them, as `lambent_capture.pictures.pictures` reads them: an
orientation in EXIF turns nothing here, it only tells where up is.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lambent_capture.pictures.exif import exif_tags
from lambent_capture.pictures.pictures import PILLOW_FORMATS, picture_size

DIAGONAL_35MM = 43.267
"""Of 36 x 24 mm, which the equivalent focal length in EXIF refers to (CIPA DCG-001)."""
FOCAL_RANGE = (0.3, 20.0)
"""Focal length over longer side; EXIF that says anything else is not believed."""
_MAKE, _MODEL, _ORIENTATION, _LENS = 0x010F, 0x0110, 0x0112, 0xA434
_FOCAL_MM, _FOCAL_35MM, _ZOOM = 0x920A, 0xA405, 0xA404
_PLANE_X, _PLANE_UNIT, _EXIF_WIDTH, _EXIF_HEIGHT = 0xA20E, 0xA210, 0xA002, 0xA003
_UNIT_MM = {2: 25.4, 3: 10.0, 4: 1.0}
_UP = {1: 0, 2: 0, 3: 2, 4: 2, 5: 1, 6: 3, 7: 3, 8: 1}
"""Quarter turns clockwise from the upper side of the picture, as it is read, to where up was, by EXIF
orientation. Mirror images are read mirrored back."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Shot:
    """What the file of a photograph says about how it was taken."""

    width: int
    height: int
    device: tuple[str, str, str] = ("", "", "")
    """Make, model and lens; empty where EXIF does not say."""
    zoom: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Focal length [mm], that of a 35 mm camera [mm], and digital zoom; 0 where not known."""
    focal_px: float = 0.0
    """Focal length in pixels as EXIF has it; 0 where it is not known or cannot be right."""
    up_turns: int = 0
    """Quarter turns clockwise from the upper side of the stored picture to where up was."""

    @property
    def is_portrait(self) -> bool:
        """Return whether the stored picture is higher than wide."""
        return self.height > self.width

    @property
    def lens(self) -> tuple[object, ...]:
        """Return what photographs with the same lens have in common: device, zoom, size up to a turn."""
        return (*self.device, *self.zoom, max(self.width, self.height), min(self.width, self.height))


def read_shot(path: Path) -> Shot:
    """Return the facts in a picture's header; raises `PictureError` for a file that cannot be opened."""
    width, height = picture_size(path)
    tags = _tags(path)
    texts = tuple(str(tags.get(tag) or "").strip("\0 ") for tag in (_MAKE, _MODEL, _LENS))
    numbers = tuple(round(_positive(tags.get(tag)), 3) for tag in (_FOCAL_MM, _FOCAL_35MM, _ZOOM))
    return Shot(
        width=width,
        height=height,
        device=(texts[0], texts[1], texts[2]),
        zoom=(numbers[0], numbers[1], numbers[2]),
        focal_px=_focal_px(tags, numbers[0], numbers[1], width, height),
        up_turns=_UP.get(int(_positive(tags.get(_ORIENTATION))), 0),
    )


def _tags(path: Path) -> dict[int, Any]:
    """Return EXIF tags of a picture; none where there are none, or they are damaged."""
    if path.suffix.lower() not in PILLOW_FORMATS:
        return {}
    first, folder = exif_tags(path)
    return {**first, **folder}


def _focal_px(tags: dict[int, Any], focal_mm: float, focal_35mm: float, width: int, height: int) -> float:
    """Return the focal length in stored pixels, from its 35 mm equivalent or from the sensor's pixels.

    The equivalent compares diagonals. Source: EXIF 2.32, FocalLengthIn35mmFilm, FocalPlaneXResolution.
    """
    focal = focal_35mm / DIAGONAL_35MM * float(np.hypot(width, height))
    if not focal:
        unit = _UNIT_MM.get(int(_positive(tags.get(_PLANE_UNIT)) or 2), 25.4)
        sensor_px = max(_positive(tags.get(_EXIF_WIDTH)), _positive(tags.get(_EXIF_HEIGHT)))
        # The resolution counts pixels of the photograph as taken; it may have been reduced since.
        scale = max(width, height) / sensor_px if sensor_px else 1.0
        focal = focal_mm * _positive(tags.get(_PLANE_X)) / unit * scale
    low, high = FOCAL_RANGE
    return focal if low <= focal / max(width, height) <= high else 0.0


def _positive(value: object) -> float:
    """Return an EXIF number, or 0 where it is none above 0."""
    if isinstance(value, tuple | list):
        value = value[0] if value else 0.0
    try:
        number = float(value)  # type: ignore[arg-type]  # EXIF rationals know how to become floats
    except (TypeError, ValueError, ZeroDivisionError):
        return 0.0
    return number if 0.0 < number < 1e9 else 0.0
