"""Small pictures and masks of every frame of a capture, for a person to look at and to correct.

    <out>/frames.json            {"version": 1, "editable": true, "overlap": 0.93, "doubtful": ["IMG_7"],
                                  "reason": "", "frames": [{"name": "IMG_7", "width": 4032, "height": 3024,
                                  "picture": "pictures/IMG_7.jpg", "mask": "masks/IMG_7.png",
                                  "overlap": 0.61}]}
    <out>/pictures/<frame>.jpg   longer side at most `SIDE` pixels
    <out>/masks/<frame>.png      as large as the picture, 0 background to 255 object

Pictures and masks are turned upright. Sizes in frames.json are those of the upright photographs, in which
corrections are given. `overlap` is how well a mask agrees with what the others make of it, 0..1, of the
capture the median; `reason` says why masks are not credible. Masks that the capture brings cannot be
corrected (`editable` is false, nothing is compared).
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from lambent_core.files import write_json
from lambent_proto.v1 import scene_pb2
from PIL import Image

from lambent_capture.arrays import Grey, PerView
from lambent_capture.masks.consensus import MaskView
from lambent_capture.masks.estimate import EstimateSettings
from lambent_capture.masks.final import preview_masks
from lambent_capture.masks.folder import DOUBTFUL_OVERLAP, SHEET, contact_sheet, judged
from lambent_capture.masks.workspace import Workspace
from lambent_capture.pictures.coverage import frame_mask
from lambent_capture.pictures.picture import box_averaged
from lambent_capture.pictures.pictures import read_picture
from lambent_capture.pictures.upright import turned_pixels, turned_size, upright_turns
from lambent_capture.scenes.picture_camera import PictureCamera

VERSION = 1
SIDE = 640
"""Longer side of pictures that are read for this, pixels; those of an estimate keep their size."""
FRAMES, PICTURES, MASKS = "frames.json", "pictures", "masks"
_QUALITY = 88


def write_estimated(work: Workspace, out: Path) -> None:
    """Write the previews of an estimate, or of what corrections have made of it."""
    views = [work.view(number) for number in range(len(work.names))]
    coverages = [np.asarray(mask, dtype=np.float32) for mask in preview_masks(work)]
    sizes = [(camera.width, camera.height) for camera in work.cameras]
    overlap, reason = judged(work, coverages, views, EstimateSettings())
    _write(out, views, coverages, sizes, overlap, reason)


def write_given(folder: Path, manifest: scene_pb2.SceneManifest, out: Path) -> None:
    """Write the previews of the masks, or the alpha, that the capture in `folder` brings.

    Raises `PictureError` for a picture that cannot be read.
    """
    views, coverages, sizes = [], [], []
    for frame in manifest.frames:
        image = min(frame.images, key=lambda image: image.light not in manifest.lights)
        picture = read_picture(folder / image.path, side=SIDE)
        alpha, size = picture.coverage(), picture.size
        mask = frame_mask(folder, frame)
        if mask is not None:
            alpha = np.minimum(alpha, box_averaged(mask.coverage, size))
        camera = PictureCamera.of_frame(frame)
        views.append(MaskView(frame.name, picture.srgb(), camera.resized(*size)))
        coverages.append(alpha)
        sizes.append((camera.width, camera.height))
    _write(out, views, coverages, sizes, overlap=None, reason="")


def _write(
    out: Path,
    views: Sequence[MaskView],
    coverages: Sequence[Grey],
    sizes: Sequence[tuple[int, int]],
    overlap: PerView | None,
    reason: str,
) -> None:
    """Write everything; `overlap` is None for masks that are not compared with each other."""
    for name in (PICTURES, MASKS):
        (out / name).mkdir(parents=True, exist_ok=True)
    frames: list[dict[str, Any]] = []
    for number, (view, coverage) in enumerate(zip(views, coverages, strict=True)):
        turns = upright_turns(view.camera.camera_to_world)
        width, height = turned_size(sizes[number], turns)
        entry: dict[str, Any] = {
            "name": view.name,
            "width": width,
            "height": height,
            "picture": f"{PICTURES}/{view.name}.jpg",
            "mask": f"{MASKS}/{view.name}.png",
        }
        mask = np.round(255.0 * coverage).astype(np.uint8)
        Image.fromarray(turned_pixels(view.image_srgb, turns)).save(out / entry["picture"], quality=_QUALITY)
        Image.fromarray(turned_pixels(mask, turns)).save(out / entry["mask"])
        if overlap is not None:
            entry["overlap"] = round(float(overlap[number]), 4)
        frames.append(entry)
    shares = [] if overlap is None else list(zip(overlap.tolist(), (v.name for v in views), strict=True))
    record = {
        "version": VERSION,
        "editable": overlap is not None,
        "overlap": round(float(np.median(overlap)), 4) if overlap is not None else 1.0,
        "doubtful": [name for share, name in sorted(shares) if share < DOUBTFUL_OVERLAP],
        "reason": reason,
        "frames": frames,
    }
    contact_sheet(views, coverages, reason).save(out / SHEET, quality=90, subsampling=0)
    write_json(out / FRAMES, record)
