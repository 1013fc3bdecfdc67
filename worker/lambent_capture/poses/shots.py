"""Facts about photographs that help to find their cameras: size, lens, zoom, and which way was up.

Everything is about the pixels as the file stores them, as `lambent_capture.pictures.pictures` reads them: an
orientation in EXIF turns nothing here, it only tells where up is.
"""

from dataclasses import dataclass
from pathlib import Path

from lambent_capture.pictures.exif import ExifFacts, exif_facts
from lambent_capture.pictures.pictures import PILLOW_FORMATS, picture_size

FOCAL_RANGE = (0.3, 20.0)
"""Focal length over longer side; EXIF that says anything else is not used."""
_UP = {1: 0, 3: 2, 6: 3, 8: 1}
"""Quarter turns clockwise from the upper side of the picture, to where up was, by EXIF orientation."""


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
    facts = exif_facts(path) if path.suffix.lower() in PILLOW_FORMATS else ExifFacts()
    focal, (low, high) = facts.focal_pixels(width, height), FOCAL_RANGE
    return Shot(
        width=width,
        height=height,
        device=(facts.make, facts.model, facts.lens),
        zoom=(round(facts.focal_mm, 3), round(facts.focal_35mm, 3), round(facts.digital_zoom, 3)),
        focal_px=focal if low <= focal / max(width, height) <= high else 0.0,
        up_turns=_UP[facts.orientation],
    )
