"""Writes the masks of a capture to a folder, with a sheet of thumbnails for checking."""

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from lambent_core.errors import WorkerError
from lambent_proto.v1 import scene_pb2
from PIL import Image, ImageDraw

from lambent_capture.arrays import Grey, Grey8, PerView
from lambent_capture.checks.observe import outlined_picture
from lambent_capture.masks.consensus import MaskView
from lambent_capture.masks.corrections import Correction
from lambent_capture.masks.estimate import (
    Estimate,
    EstimateSettings,
    consistency_of,
    not_credible,
    separation_of,
    too_few,
    why_not_credible,
)
from lambent_capture.masks.final import FinalSettings, colours_of, final_mask
from lambent_capture.masks.find import FindSettings, find_object
from lambent_capture.masks.photograph import Photograph, Progress, SparsePoints, photographs_of
from lambent_capture.masks.propagate import propagated
from lambent_capture.masks.segmenter import Segmenter
from lambent_capture.masks.workspace import Workspace
from lambent_capture.pictures.mask_levels import write_mask
from lambent_capture.pictures.picture import box_averaged
from lambent_capture.pictures.resample import reduced_size
from lambent_capture.pictures.upright import turned_pixels, upright_turns

MASKS, SHEET = "masks", "masks.jpg"
VIEW_SIDE = 512
"""Longer side of the pictures that segmenters get, pixels; the files get the size of their photographs."""
DOUBTFUL_OVERLAP = 0.75
"""Views that overlap less with what the others make of them are named."""
_THUMBNAIL_SIDE = 160
_COLUMNS = 8
_BEHIND = 0.4
"""Visible share of the background, so that lost parts of the object can be seen."""
_LABEL_HEIGHT = 14
_LETTER_WIDTH = 6
_REMEMBERED_SIDE = 512
"""Longer side at which masks are remembered, pixels."""


@dataclass(frozen=True, kw_only=True, slots=True)
class WrittenMasks:
    """Result of `write_masks`."""

    folder: Path
    """One PNG for each frame, named like it."""
    sheet: Path
    """Thumbnails with the outlines."""
    overlap: float
    """Median agreement of the views, 0..1; 1 for masks from an external segmenter."""
    doubtful: tuple[str, ...]
    """Frames on which the views do not agree, the worst first."""
    reason: str = ""
    """Why the masks are not credible; empty where they are."""
    markable: bool = False
    """Whether a person's marks may show where the object is."""

    def require_credible(self) -> None:
        """Raise `SceneRefusedError` with `scene.mask_missing` where the masks are not credible."""
        if self.reason:
            raise not_credible(
                f"{self.reason} (what was found is in {self.sheet} and {self.folder})", markable=self.markable
            )


def write_masks(
    folder: Path,
    manifest: scene_pb2.SceneManifest,
    out: Path,
    segmenter: Segmenter | None = None,
    progress: Progress = lambda phase, done, total: None,
    *,
    points: SparsePoints | None = None,
) -> WrittenMasks:
    """Write `out`/masks/<frame>.png for the capture in `folder`, and `out`/masks.jpg for checking.

    By the built-in estimate, or by `segmenter`. `points` are sparse points in the coordinates of `manifest`,
    by which the support is found and taken away; without them they are triangulated. Masks and
    thumbnails are written in any case; `WrittenMasks.reason` says why they are not credible, and
    `require_credible` refuses them. `progress` is called with the phase and how much of how much of it is
    done; what it raises stops the work.
    """
    photographs = photographs_of(folder, manifest)
    if segmenter is not None:
        return _by_segmenter(photographs, out, segmenter, progress)
    return draw_into(
        find_object(photographs, points, FindSettings(), progress), photographs, out, (), progress
    )


def draw_into(
    work: Workspace | str,
    photographs: Sequence[Photograph],
    out: Path,
    corrections: Sequence[Correction],
    progress: Progress,
) -> WrittenMasks:
    """Write masks and thumbnails of what was found, or why nothing was, after a person's corrections.

    Raises `UsageError` (`config.corrections_invalid`) where they name a frame that is not there.
    """
    writer = MaskWriter(out, photographs)
    if isinstance(work, str):
        for number in range(len(photographs)):
            camera = photographs[number].camera
            writer.write(number, np.zeros((camera.height, camera.width), np.uint8))
        return writer.finish(np.zeros(len(photographs)), work)
    corrected = propagated(work, corrections)
    return draw_masks(corrected, photographs, writer, FindSettings().plain, progress)


def draw_masks(
    work: Workspace,
    photographs: Sequence[Photograph],
    writer: "MaskWriter",
    settings: EstimateSettings,
    progress: Progress,
) -> WrittenMasks:
    """Write the mask of every photograph at its own size, one at a time, and judge them all."""
    colours = colours_of(work)
    for number, photograph in enumerate(photographs):
        writer.write(number, final_mask(photograph, number, work, colours, FinalSettings()))
        progress("drawing outlines", number + 1, len(photographs))
    views = [work.view(number) for number in range(len(photographs))]
    small = [view.box_averaged(settings.consensus_side) for view in views]
    overlap, reason = judged(work, writer.coverages, small, settings)
    return replace(writer.finish(overlap, reason), markable=True)


def judged(
    work: Workspace, coverages: Sequence[Grey], compared: Sequence[MaskView], settings: EstimateSettings
) -> tuple[PerView, str]:
    """Return how well each mask agrees with the others, 0..1, and why not to trust them, or "".

    `compared` are the views at the size at which colours inside and outside are compared. Marks of a person
    are never doubted for lack of views.
    """
    views = [work.view(number) for number in range(len(work.names))]
    consistency = consistency_of(coverages, views, work.centre, work.distance, settings)
    reason = work.reason
    if work.seeds:
        empty = all(not (coverage >= 0.5).any() for coverage in coverages)
        reason = "what was marked leaves nothing of the object" if empty else ""
    elif not reason and len(work.names) < settings.min_views:
        reason = too_few(len(work.names))
    elif not reason:
        estimate = Estimate(list(coverages), consistency, separation_of(compared, coverages))
        reason = why_not_credible(estimate, settings)
    return consistency.overlap, reason


class MaskWriter:
    """Writes masks as they are made, and remembers them small for the thumbnails and the judgement."""

    def __init__(self, out: Path, photographs: Sequence[Photograph]) -> None:
        self._out, self._photographs = out, photographs
        self.coverages: list[Grey] = []
        """0..1, longer side at most `_REMEMBERED_SIDE` pixels."""
        (out / MASKS).mkdir(parents=True, exist_ok=True)

    def write(self, number: int, mask: Grey8) -> None:
        """Write the mask of photograph `number`, 0 to 255 in its pixels; photographs come in order."""
        photograph = self._photographs[number]
        write_mask(self._out / MASKS / f"{photograph.name}.png", mask, compress_level=3)
        size = reduced_size(mask.shape[1], mask.shape[0], _REMEMBERED_SIDE)
        coverage = box_averaged(mask.astype(np.float32) / np.float32(255.0), size)
        self.coverages.append(coverage.astype(np.float64))

    def finish(self, overlap: PerView, reason: str) -> WrittenMasks:
        """Write the thumbnails and return what was written."""
        sheet = self._out / SHEET
        views = [photograph.reduced(_THUMBNAIL_SIDE) for photograph in self._photographs]
        contact_sheet(views, self.coverages, reason).save(sheet, quality=90, subsampling=0)
        names = [photograph.name for photograph in self._photographs]
        return WrittenMasks(
            folder=self._out / MASKS,
            sheet=sheet,
            overlap=float(np.median(overlap)),
            doubtful=tuple(names[i] for i in np.argsort(overlap) if overlap[i] < DOUBTFUL_OVERLAP),
            reason=reason,
        )


def _by_segmenter(
    photographs: Sequence[Photograph], out: Path, segmenter: Segmenter, progress: Progress
) -> WrittenMasks:
    views = []
    for number, photograph in enumerate(photographs):
        views.append(photograph.reduced(VIEW_SIDE))
        progress("reading photographs", number + 1, len(photographs))
    coverages = segmenter(views)
    _require_sizes(views, coverages)
    writer = MaskWriter(out, photographs)
    for number, (photograph, coverage) in enumerate(zip(photographs, coverages, strict=True)):
        grey = Image.fromarray(np.round(255.0 * np.clip(coverage, 0.0, 1.0)).astype(np.uint8))
        size = (photograph.camera.width, photograph.camera.height)
        writer.write(number, np.asarray(grey.resize(size, Image.Resampling.BILINEAR)))
        progress("writing masks", number + 1, len(photographs))
    return writer.finish(np.ones(len(views)), "")


def contact_sheet(views: Sequence[MaskView], coverages: Sequence[Grey], reason: str = "") -> Image.Image:
    """Return all pictures, small and upright, with the background dimmed, outlines and the frames' names.

    `reason` says at the top why the masks are not credible.
    """
    thumbnails = []
    for view, coverage in zip(views, coverages, strict=True):
        fitted = box_averaged(coverage.astype(np.float32), (view.camera.width, view.camera.height))
        turns = upright_turns(view.camera.camera_to_world)
        picture, fitted = (turned_pixels(each, turns) for each in (view.image_srgb, fitted))
        thumbnails.append(outlined_picture(picture, fitted, _THUMBNAIL_SIDE, _BEHIND))
    width = max(each.shape[1] for each in thumbnails) + 4
    height = max(each.shape[0] for each in thumbnails) + _LABEL_HEIGHT + 4
    columns = min(_COLUMNS, len(thumbnails))
    rows = -(-len(thumbnails) // columns)
    lines = textwrap.wrap(f"not used: {reason}", max(columns * width // _LETTER_WIDTH, 10)) if reason else []
    head = len(lines) * _LABEL_HEIGHT
    sheet = Image.new("RGB", (columns * width, head + rows * height), (255, 255, 255))
    draw = ImageDraw.Draw(sheet)
    for number, line in enumerate(lines):
        draw.text((2, number * _LABEL_HEIGHT + 1), line, fill=(190, 0, 0))
    for number, (view, thumbnail) in enumerate(zip(views, thumbnails, strict=True)):
        left, top = number % columns * width, head + number // columns * height
        sheet.paste(Image.fromarray(thumbnail), (left, top))
        draw.text((left + 2, top + thumbnail.shape[0] + 1), view.name[-26:], fill=(0, 0, 0))
    return sheet


def _require_sizes(views: Sequence[MaskView], coverages: Sequence[Grey]) -> None:
    if len(coverages) != len(views):
        raise WorkerError(
            "scene.mask_file_missing",
            f"the segmenter returned {len(coverages)} masks for {len(views)} pictures; return one for each",
        )
    for view, coverage in zip(views, coverages, strict=True):
        if coverage.shape != view.image_srgb.shape[:2]:
            raise WorkerError(
                "scene.mask_size",
                f'the segmenter\'s mask of frame "{view.name}" has the shape {coverage.shape}, its picture '
                f"{view.image_srgb.shape[:2]}; return one number for each pixel",
            )
