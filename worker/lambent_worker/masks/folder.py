"""Writes the masks of a capture to a folder, with a sheet of thumbnails for checking."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from lambent_proto.v1 import scene_pb2
from lambent_relight.images import srgb_from_linear
from numpy import ndarray
from PIL import Image, ImageDraw

from lambent_worker.capture_qa.observe import outlined_picture, read_small
from lambent_worker.capture_qa.picture_camera import PictureCamera
from lambent_worker.errors import WorkerError
from lambent_worker.masks.consensus import MaskView
from lambent_worker.masks.estimate import EstimateSettings, estimate_masks
from lambent_worker.masks.segmenter import Segmenter
from lambent_worker.scenes.picture_error import PictureError
from lambent_worker.scenes.resample import reduced_size

VIEW_SIDE = 512
"""Longer side at which outlines are drawn, pixels; the files get the size of their pictures."""
DOUBTFUL_OVERLAP = 0.75
"""Views that overlap less with what the others make of them are named."""
_THUMBNAIL_SIDE = 160
_COLUMNS = 8
_BEHIND = 0.4
"""Visible share of the background, so that lost parts of the object can be seen."""
_LABEL_HEIGHT = 14


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


def write_masks(
    folder: Path,
    manifest: scene_pb2.SceneManifest,
    out: Path,
    segmenter: Segmenter | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> WrittenMasks:
    """Write `out`/masks/<frame>.png for the capture in `folder`, and `out`/masks.jpg for checking.

    By the built-in estimate, or by `segmenter`. Raises `SceneRefusedError` with `scene.mask_missing` where
    the object was not found. `progress` is called with the number of frames done and of all.
    """
    frames = [frame for frame in manifest.frames if frame.images]
    views = []
    for number, frame in enumerate(frames):
        views.append(_read(folder, frame, manifest))
        progress(number, 2 * len(frames))
    coverages: Sequence[Float[ndarray, "height width"]]
    if segmenter is None:
        estimate = estimate_masks(views, EstimateSettings())
        coverages, overlap = estimate.coverages, estimate.consistency.overlap
    else:
        coverages, overlap = segmenter(views), np.ones(len(views))
        _require_sizes(views, coverages)
    masks = out / "masks"
    masks.mkdir(parents=True, exist_ok=True)
    for number, (frame, coverage) in enumerate(zip(frames, coverages, strict=True)):
        size = PictureCamera.of_frame(frame)
        grey = Image.fromarray(np.round(255.0 * np.clip(coverage, 0.0, 1.0)).astype(np.uint8))
        grey.resize((size.width, size.height), Image.Resampling.BILINEAR).save(masks / f"{frame.name}.png")
        progress(len(frames) + number, 2 * len(frames))
    sheet = out / "masks.jpg"
    contact_sheet(views, coverages).save(sheet, quality=90, subsampling=0)
    return WrittenMasks(
        folder=masks,
        sheet=sheet,
        overlap=float(np.median(overlap)),
        doubtful=tuple(frames[i].name for i in np.argsort(overlap) if overlap[i] < DOUBTFUL_OVERLAP),
    )


def contact_sheet(
    views: Sequence[MaskView], coverages: Sequence[Float[ndarray, "height width"]]
) -> Image.Image:
    """Return all pictures, small, with the background dimmed, the outline drawn and the frame's name."""
    thumbnails = [
        outlined_picture(view.image_srgb, coverage, _THUMBNAIL_SIDE, _BEHIND)
        for view, coverage in zip(views, coverages, strict=True)
    ]
    width = max(each.shape[1] for each in thumbnails) + 4
    height = max(each.shape[0] for each in thumbnails) + _LABEL_HEIGHT + 4
    columns = min(_COLUMNS, len(thumbnails))
    rows = -(-len(thumbnails) // columns)
    sheet = Image.new("RGB", (columns * width, rows * height), (255, 255, 255))
    draw = ImageDraw.Draw(sheet)
    for number, (view, thumbnail) in enumerate(zip(views, thumbnails, strict=True)):
        left, top = number % columns * width, number // columns * height
        sheet.paste(Image.fromarray(thumbnail), (left, top))
        draw.text((left + 2, top + thumbnail.shape[0] + 1), view.name[-26:], fill=(0, 0, 0))
    return sheet


def _read(folder: Path, frame: scene_pb2.Frame, manifest: scene_pb2.SceneManifest) -> MaskView:
    """Return a frame's picture in the first of the training lights that it has one in, small."""
    images = sorted(frame.images, key=lambda image: image.light not in manifest.lights)
    try:
        colours, _, is_linear = read_small(folder / images[0].path, VIEW_SIDE)
    except PictureError as error:
        raise WorkerError(error.code, f"{images[0].path} {error}") from error
    if is_linear:
        colours = np.round(255.0 * srgb_from_linear(colours)).astype(np.uint8)
    camera = PictureCamera.of_frame(frame)
    size = reduced_size(camera.width, camera.height, VIEW_SIDE)
    return MaskView(frame.name, colours, camera.resized(*size))


def _require_sizes(views: Sequence[MaskView], coverages: Sequence[Float[ndarray, "height width"]]) -> None:
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
