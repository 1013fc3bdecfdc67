"""The masks of a capture while a person corrects them: small ones of all photographs, soon."""

import io
import threading
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from PIL import Image

from lambent_capture.arrays import Region
from lambent_capture.masks.corrections import Correction
from lambent_capture.masks.estimate import EstimateSettings, consistency_of
from lambent_capture.masks.final import preview_masks
from lambent_capture.masks.folder import DOUBTFUL_OVERLAP
from lambent_capture.masks.photograph import Photograph
from lambent_capture.masks.propagate import propagated, require_frames
from lambent_capture.masks.workspace import Workspace
from lambent_capture.pictures.upright import turned_pixels, turned_size, upright_turns

LARGEST_SIDE = 2400
"""Longer side of the largest pictures that are made, pixels."""
_QUALITY = 85


class Superseded(Exception):  # noqa: N818 - not a mistake of anyone
    """Later corrections have come, so that nobody waits for these."""


@dataclass(frozen=True, kw_only=True, slots=True)
class EditedMasks:
    """What corrections have made of the masks."""

    overlap: float
    """Median agreement of the views, 0..1."""
    doubtful: tuple[str, ...]
    """Frames on which the views do not agree, the worst first."""
    changed: tuple[str, ...]
    """Frames whose small mask differs from the one before."""
    reason: str
    """Why nothing was found before corrections; empty where something was."""


class Editing:
    """Draws small masks of all photographs after corrections. May be used by several threads at once."""

    def __init__(self, work: Workspace, photographs: Sequence[Photograph]) -> None:
        """`work` is what the estimate has kept of `photographs`."""
        self.work = work
        self._photographs = {photograph.name: photograph for photograph in photographs}
        self._numbers = {name: number for number, name in enumerate(work.names)}
        self._masks: list[Region | None] = [None] * len(work.names)
        self._asked = 0
        self._asking = threading.Lock()
        self._drawing = threading.Lock()
        self.last = EditedMasks(overlap=0.0, doubtful=(), changed=(), reason=work.reason)
        """The masks that are shown now."""

    def apply(self, corrections: Sequence[Correction]) -> EditedMasks:
        """Draw all masks with these corrections, which are complete, and return what has changed.

        Raises `Superseded` where other corrections are asked for before these are drawn, and `UsageError`
        (`config.corrections_invalid`) for a frame that the capture does not have.
        """
        with self._asking:
            self._asked += 1
            mine = self._asked

        def go_on() -> None:
            if self._asked != mine:
                raise Superseded

        with self._drawing:
            go_on()
            work = propagated(self.work, corrections)
            self._keep(preview_masks(work, go_on=go_on))
        return self.last

    def _keep(self, masks: list[Region]) -> None:
        work = self.work
        views = [work.view(number) for number in range(len(work.names))]
        coverages = [mask.astype(np.float64) for mask in masks]
        consistency = consistency_of(coverages, views, work.centre, work.distance, EstimateSettings())
        overlap = consistency.overlap
        changed = [
            name
            for name, before, after in zip(work.names, self._masks, masks, strict=True)
            if before is None or not np.array_equal(before, after)
        ]
        self._masks = list(masks)
        self.last = EditedMasks(
            overlap=float(np.median(overlap)),
            doubtful=tuple(work.names[i] for i in np.argsort(overlap) if overlap[i] < DOUBTFUL_OVERLAP),
            changed=tuple(changed),
            reason=work.reason,
        )

    def turns(self, name: str) -> int:
        """Return by how many quarter turns to the left a frame's picture and mask are shown upright."""
        return upright_turns(self.work.cameras[self._numbers[name]].camera_to_world)

    def size(self, name: str) -> tuple[int, int]:
        """Return width and height of a photograph, upright."""
        camera = self.work.cameras[self._numbers[name]]
        return turned_size((camera.width, camera.height), self.turns(name))

    def has(self, name: str) -> bool:
        """Return whether there is a frame of this name."""
        return name in self._numbers

    def require_frames(self, corrections: Sequence[Correction]) -> None:
        """Raise `UsageError` (`config.corrections_invalid`) for a frame that the capture does not have."""
        require_frames(self.work, corrections)

    def mask_png(self, name: str) -> bytes:
        """Return the mask of a frame as a small grey PNG, upright, 0 or 255; all 0 before `apply`."""
        number = self._numbers[name]
        mask = self._masks[number]
        if mask is None:
            mask = np.zeros(self.work.pictures[number].shape[:2], dtype=bool)
        shown = turned_pixels(np.where(mask, 255, 0).astype(np.uint8), self.turns(name))
        return _encoded(Image.fromarray(shown), "PNG")

    def picture_jpeg(self, name: str, side: int) -> bytes:
        """Return a photograph as JPEG, upright, longer side at most `side` and `LARGEST_SIDE` pixels."""
        side = min(max(side, 16), LARGEST_SIDE)
        picture = self.work.pictures[self._numbers[name]]
        if side > max(picture.shape[:2]):
            picture = self._photographs[name].reduced(side).image_srgb
        image = Image.fromarray(turned_pixels(picture, self.turns(name)))
        image.thumbnail((side, side), Image.Resampling.BOX)
        return _encoded(image, "JPEG", quality=_QUALITY)


def _encoded(image: Image.Image, kind: str, **options: int) -> bytes:
    buffer = io.BytesIO()
    image.save(buffer, kind, **options)
    return buffer.getvalue()
