"""Exposure of each photograph, from EXIF or from the capture's metadata."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from lambent_proto.v1 import scene_pb2

from lambent_capture.pictures.exif import exif_facts
from lambent_capture.pictures.picture_error import PictureError
from lambent_capture.problems import Problems
from lambent_capture.scenes.reading import finite_number

SAME = 0.01
"""Relative difference below which two exposures are the same: cameras round what they write."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Exposure:
    """Settings of a photograph; 0 where it is not known."""

    time_s: float = 0.0
    f_number: float = 0.0
    iso: float = 0.0

    @property
    def known(self) -> tuple[bool, bool, bool]:
        """Return which settings are known."""
        return self.time_s > 0.0, self.f_number > 0.0, self.iso > 0.0

    @property
    def light(self) -> float:
        """Return the factor that pixel values are proportional to, without unknown settings."""
        return (self.time_s or 1.0) * (self.iso or 1.0) / (self.f_number or 1.0) ** 2


def stated_exposure(settings: dict[str, Any]) -> Exposure | None:
    """Return the exposure that a frame's entry states with `exposure_time`, `f_number` and `iso`."""
    values = [finite_number(settings.get(key)) or 0.0 for key in ("exposure_time", "f_number", "iso")]
    if max(values) <= 0.0:
        return None
    time_s, f_number, iso = (max(value, 0.0) for value in values)
    return Exposure(time_s=time_s, f_number=f_number, iso=iso)


def exif_exposure(path: Path) -> Exposure | None:
    """Return the exposure in a picture's EXIF, or None where there is none; reads the header only.

    Raises `PictureError` for a file that cannot be opened.
    """
    facts = exif_facts(path)
    exposure = Exposure(time_s=facts.time_s, f_number=facts.f_number, iso=facts.iso)
    return exposure if any(exposure.known) else None


def set_exposures(
    folder: Path, frames: list[scene_pb2.Frame], stated: dict[str, Exposure], problems: Problems
) -> None:
    """Fill in `Frame.exposure` where the photographs differ: exposure of the first frame over its own.

    `stated` (by frame name) overrides EXIF. Where only some photographs tell, or those of one frame (under
    several lights) disagree on its factor, all factors stay 1 and a finding says so.
    """
    for frame in frames:
        frame.exposure = 1.0
    rows = [_exposures_of(folder, frame, stated) for frame in frames]
    if not rows or not any(exposure for row in rows for exposure in row.values()):
        return
    lights = set(rows[0])
    complete = all(set(row) == lights and all(row.values()) for row in rows)
    kinds = {exposure.known for row in rows for exposure in row.values() if exposure}
    silent = next(
        (frame for frame, row in zip(frames, rows, strict=True) if not all(row.values())), frames[0]
    )
    if not complete or len(kinds) > 1:
        problems.warning(
            "scene.exposure_incomplete",
            f'only some photographs say how they were exposed ("{silent.name}" does not, or says less), '
            "so no difference in exposure is evened out; keep EXIF in all photographs or in none",
            silent.name,
        )
        return
    light_of = np.array([[exposure.light for _, exposure in sorted(row.items()) if exposure] for row in rows])
    factors = light_of[0] / light_of
    if (np.abs(factors / factors[:, :1] - 1.0) > SAME).any():
        worst = int(np.abs(factors / factors[:, :1] - 1.0).max(axis=1).argmax())
        problems.warning(
            "scene.exposure_incomplete",
            f'the photographs of frame "{frames[worst].name}" under several lights changed exposure '
            "differently from those of other frames, so no difference is evened out; photograph each light "
            "with one exposure",
            frames[worst].name,
        )
        return
    for frame, factor in zip(frames, factors[:, 0], strict=True):
        frame.exposure = float(factor) if abs(factor - 1.0) > SAME else 1.0


def _exposures_of(
    folder: Path, frame: scene_pb2.Frame, stated: dict[str, Exposure]
) -> dict[str, Exposure | None]:
    """Return the exposure of each of a frame's photographs by light."""
    if frame.name in stated:
        return {image.light: stated[frame.name] for image in frame.images}
    exposures: dict[str, Exposure | None] = {}
    for image in frame.images:
        try:
            exposures[image.light] = exif_exposure(folder / image.path)
        except PictureError:  # reported where pictures are checked
            exposures[image.light] = None
    return exposures
