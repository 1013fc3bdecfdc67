"""A grey card that the user points at: `PHOTOGRAPH:left,top,width,height[:reflectance]`.

Coordinates are pixels of the full-size photograph, x to the right, y down: as the file stores it, or, where
cameras are found here, held upright as `lambent masks --edit` shows it.
"""

import re
from dataclasses import dataclass
from pathlib import Path

from lambent_capture.pictures.picture_error import PictureError
from lambent_capture.pictures.pictures import picture_size
from lambent_core.errors import UsageError

REFLECTANCE = 0.18
"""Of the grey of photographers' cards."""
LEAST_REFLECTANCE = 0.02
_NUMBER = r"\d+(?:\.\d+)?"
_FORM = re.compile(rf"(?P<name>.+?):(?P<box>{_NUMBER}(?:,{_NUMBER}){{3}})(?::(?P<reflectance>{_NUMBER}))?")


@dataclass(frozen=True, slots=True)
class GreyCard:
    """Where a photograph shows a grey card."""

    photograph: str
    """Path of the picture in the capture, or its name where only one has it."""
    box: tuple[float, float, float, float]
    """Left, top, width and height, pixels."""
    reflectance: float = REFLECTANCE

    def __str__(self) -> str:
        """Return the text that `parse_grey_card` reads."""
        numbers = [f"{value:.6f}".rstrip("0").rstrip(".") for value in (*self.box, self.reflectance)]
        return f"{self.photograph}:{','.join(numbers[:4])}:{numbers[4]}"


def parse_grey_card(text: str) -> GreyCard:
    """Return the card that `text` describes; raises `UsageError` where it is none."""
    match = _FORM.fullmatch(text.strip())
    if match is None:
        raise refused(
            "syntax",
            f'"{text}" must look like IMG_0012.jpg:820,1140,160,90 or IMG_0012.jpg:820,1140,160,90:0.18, '
            "that is PHOTOGRAPH:left,top,width,height in pixels, then the card's reflectance",
        )
    left, top, width, height = (float(side) for side in match["box"].split(","))
    if not width or not height:
        raise refused("box_empty", f'the box of "{text}" is {width:g} pixels wide and {height:g} high')
    reflectance = REFLECTANCE if match["reflectance"] is None else float(match["reflectance"])
    if not LEAST_REFLECTANCE <= reflectance <= 1.0:
        raise refused(
            "reflectance",
            f"a card reflects between {LEAST_REFLECTANCE:g} and 1, found {reflectance:g}; 18 % grey is 0.18",
        )
    return GreyCard(match["name"], (left, top, width, height), reflectance)


def look_for_photograph(scene: Path, card: GreyCard) -> None:
    """Raise `UsageError` unless `scene` holds the photograph of `card`, large enough for the box.

    Only the header of the file is read; a picture that is damaged is left to the check of the capture.
    """
    paths = [
        path
        for path in (scene.rglob("*") if scene.is_dir() else ())
        if path.is_file() and is_named(path.relative_to(scene).as_posix(), card.photograph)
    ]
    if not paths:
        raise refused(
            "photograph_missing",
            f'"{scene}" holds no photograph "{card.photograph}"; give its name, or its path in the folder',
        )
    try:
        sizes = [picture_size(path) for path in paths]
    except PictureError:
        return
    if not any(fits(card, size) or fits(card, size[::-1]) for size in sizes):
        raise outside(card, sizes[0])


def fits(card: GreyCard, size: tuple[int, int]) -> bool:
    """Return whether the box lies inside a picture of `size` = (width, height)."""
    left, top, width, height = card.box
    return left + width <= size[0] and top + height <= size[1]


def is_named(path: str, name: str) -> bool:
    """Return whether `name` is a picture's path or the end of it."""
    return path == name or path.endswith(f"/{name}")


def outside(card: GreyCard, size: tuple[int, int]) -> UsageError:
    """Return the error for a box that does not fit a picture of `size` = (width, height)."""
    left, top, width, height = card.box
    return refused(
        "box_outside",
        f'the box reaches to column {left + width:g} and row {top + height:g}, but "{card.photograph}" has '
        f"{size[0]} x {size[1]} pixels",
    )


def refused(code: str, message: str) -> UsageError:
    """Return an error about the card."""
    return UsageError(f"grey_card.{code}", f"--grey-card: {message}")
