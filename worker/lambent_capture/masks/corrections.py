"""A person's corrections of masks: boxes and strokes on a few photographs, as an ordered list.

The list is the whole state: undoing the last correction is leaving it out. As JSON:

    {"version": 1, "corrections": [
      {"frame": "IMG_0001", "label": "background", "stroke": [[310, 520], [402, 533]], "radius": 12},
      {"frame": "IMG_0007", "label": "object", "box": [120, 80, 900, 700]}]}

Coordinates are pixels of the photograph held upright (`scenes.upright`), x to the right and y down, the upper
left corner of the picture being (0, 0). A stroke is a line through its points, `radius` wide on both sides,
and says what it covers is. A box [left, top, right, bottom] labelled "background" says so of all inside of
it; labelled "object" it says that the object is inside: everything outside the photograph's object boxes is
background.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Int8
from lambent_core.errors import UsageError
from numpy import ndarray

from lambent_capture.arrays import Marks

NAME = "corrections.json"
VERSION = 1
MOST_CORRECTIONS = 10_000
MOST_POINTS = 10_000
_OBJECT, _BACKGROUND = "object", "background"


@dataclass(frozen=True, kw_only=True, slots=True)
class Correction:
    """A box or a stroke on one photograph."""

    frame: str
    is_object: bool
    points: tuple[tuple[float, float], ...]
    """Corners of a box, upper left and lower right; or the points of a stroke. Pixels of the photograph."""
    radius: float = 0.0
    """Half the width of a stroke, pixels; 0 for a box."""

    @property
    def is_box(self) -> bool:
        """Return whether it is a box."""
        return self.radius <= 0.0


def corrections_from(record: Any) -> list[Correction]:
    """Return the corrections in a decoded JSON document.

    Raises `UsageError` (`config.corrections_invalid`) for another version or an entry that is not understood.
    """
    if not isinstance(record, dict) or record.get("version") != VERSION:
        raise _invalid(f'the document must be {{"version": {VERSION}, "corrections": [...]}}')
    entries = record.get("corrections")
    if not isinstance(entries, list) or len(entries) > MOST_CORRECTIONS:
        raise _invalid(f'"corrections" must be a list of at most {MOST_CORRECTIONS} entries')
    return [_correction(number, entry) for number, entry in enumerate(entries)]


def record_of(corrections: Sequence[Correction]) -> dict[str, Any]:
    """Return the JSON document of corrections."""
    entries: list[dict[str, Any]] = []
    for each in corrections:
        entry: dict[str, Any] = {
            "frame": each.frame,
            "label": _OBJECT if each.is_object else _BACKGROUND,
        }
        if each.is_box:
            entry["box"] = [value for point in each.points for value in point]
        else:
            entry |= {"stroke": [list(point) for point in each.points], "radius": each.radius}
        entries.append(entry)
    return {"version": VERSION, "corrections": entries}


def read_corrections(path: Path) -> list[Correction]:
    """Return the corrections in a file; raises `UsageError` as `corrections_from` does."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, ValueError) as error:
        raise _invalid(f'"{path}" cannot be read') from error
    return parse_corrections(text, f'"{path}"')


def parse_corrections(text: str, source: str) -> list[Correction]:
    """Return the corrections in a text; raises `UsageError` as `corrections_from` does, naming `source`."""
    try:
        record = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise _invalid(f"{source} is not a JSON document") from error
    return corrections_from(record)


def seeds_of(
    corrections: Sequence[Correction], frame: str, size: tuple[int, int], scale: tuple[float, float]
) -> Marks | None:
    """Return what corrections say about the pixels of one frame: 1 object, -1 background, 0 nothing.

    `size` is the picture's width and height, `scale` what coordinates of the photograph are multiplied by to
    be in its pixels. Later corrections go before earlier ones. None where none is about this frame.
    """
    own = [each for each in corrections if each.frame == frame]
    if not own:
        return None
    seeds = np.zeros((size[1], size[0]), dtype=np.int8)
    boxes = [each for each in own if each.is_box and each.is_object]
    if boxes:
        seeds[:] = -1
        for box in boxes:
            seeds[_inside(box, size, scale)] = 0
    for each in own:
        if each.is_box and not each.is_object:
            seeds[_inside(each, size, scale)] = -1
        elif not each.is_box:
            seeds[_stroke(each, size, scale)] = 1 if each.is_object else -1
    return seeds


def reduced_seeds(seeds: Marks, size: tuple[int, int]) -> Int8[ndarray, "rows columns"]:
    """Return seeds for a smaller picture of `size` (width, height); thin strokes are kept."""
    mean = cv2.resize(seeds.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    return np.where(np.abs(mean) >= 0.25, np.sign(mean), 0.0).astype(np.int8)


def _inside(box: Correction, size: tuple[int, int], scale: tuple[float, float]) -> tuple[slice, slice]:
    (left, top), (right, bottom) = box.points
    columns = np.clip(np.round(np.array([left, right]) * scale[0]), 0, size[0]).astype(int)
    rows = np.clip(np.round(np.array([top, bottom]) * scale[1]), 0, size[1]).astype(int)
    return slice(rows[0], rows[1]), slice(columns[0], columns[1])


def _stroke(each: Correction, size: tuple[int, int], scale: tuple[float, float]) -> ndarray:
    drawn = np.zeros((size[1], size[0]), dtype=np.uint8)
    reach = 4.0 * max(size)
    points = np.clip(np.array(each.points) * scale, -reach, reach)
    # With four binary digits behind the point; pixel centres are at whole numbers for `cv2`.
    fixed = np.round((points - 0.5) * 16.0).astype(np.int32)
    radius = max(each.radius * 0.5 * (scale[0] + scale[1]), 0.5)
    for point in fixed:
        cv2.circle(drawn, point.tolist(), round(radius * 16.0), 1, -1, cv2.LINE_8, 4)
    if len(fixed) > 1:
        width = max(1, min(round(2.0 * radius), 32767))
        cv2.polylines(drawn, [fixed[:, None]], False, 1, width, cv2.LINE_8, 4)
    return np.asarray(drawn > 0)


def _correction(number: int, entry: Any) -> Correction:
    where = f"correction {number}"
    if not isinstance(entry, dict) or not isinstance(entry.get("frame"), str):
        raise _invalid(f'{where} needs the name of its "frame"')
    label = entry.get("label")
    if label not in (_OBJECT, _BACKGROUND):
        raise _invalid(f'{where} needs the "label" "{_OBJECT}" or "{_BACKGROUND}"')
    if ("box" in entry) == ("stroke" in entry):
        raise _invalid(f'{where} needs either a "box" or a "stroke"')
    if "box" in entry:
        left, top, right, bottom = _numbers(entry["box"], 4, f'{where}: "box"')
        if right <= left or bottom <= top:
            raise _invalid(f'{where}: "box" must be [left, top, right, bottom] of more than no size')
        return Correction(
            frame=entry["frame"], is_object=label == _OBJECT, points=((left, top), (right, bottom))
        )
    stroke = entry["stroke"]
    if not isinstance(stroke, list) or not 1 <= len(stroke) <= MOST_POINTS:
        raise _invalid(f'{where}: "stroke" must be a list of 1 to {MOST_POINTS} points')
    points = [_numbers(point, 2, f'{where}: a point of "stroke"') for point in stroke]
    (radius,) = _numbers([entry.get("radius")], 1, f'{where}: "radius"')
    if radius <= 0.0:
        raise _invalid(f'{where}: "radius" must be greater than 0')
    return Correction(
        frame=entry["frame"],
        is_object=label == _OBJECT,
        points=tuple((point[0], point[1]) for point in points),
        radius=radius,
    )


def _numbers(values: Any, count: int, what: str) -> list[float]:
    if not isinstance(values, list) or len(values) != count:
        raise _invalid(f"{what} must have {count} numbers")
    for value in values:
        if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= 1e6:
            raise _invalid(f"{what} must have {count} numbers in pixels")
    return [float(value) for value in values]


def _invalid(reason: str) -> UsageError:
    return UsageError("config.corrections_invalid", f"the corrections of masks cannot be used: {reason}")
