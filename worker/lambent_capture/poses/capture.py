"""Turns a folder of photographs into a capture of the layout `colmap`."""

import shutil
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from lambent_core.errors import SceneRefusedError, UsageError
from lambent_core.files import digest, file_sha256, read_record, write_json
from lambent_core.measured import measured
from lambent_core.messages import message_to_dict
from PIL import Image

from lambent_capture.pictures.exif import exif_facts
from lambent_capture.pictures.mask_levels import write_mask
from lambent_capture.pictures.pictures import PILLOW_FORMATS, picture_format, read_picture
from lambent_capture.poses.advice import PoseLimits, advise
from lambent_capture.poses.apart import solve_apart
from lambent_capture.poses.photographs import IMAGES, MASKS, Photographs, find_photographs
from lambent_capture.poses.solution import MODEL, Solution
from lambent_capture.poses.solve import PoseProgress, PoseSettings
from lambent_capture.problems import Problems

RECORD = "poses.json"
WORK = ".lambent-poses"
"""Folder within the capture for what an interrupted search has found; removed once it is done."""


def solve_capture(
    photographs_dir: Path,
    out: Path,
    masks_dir: Path | None = None,
    settings: PoseSettings | None = None,
    progress: PoseProgress = lambda phase, done, total: None,
) -> dict[str, Any]:
    """Write a capture to `out` with the photographs whose cameras were found, and return its `poses.json`.

    That has photographs, registered, missing, points, reprojection_error_px and findings. Where `out` was
    made from the same photographs, masks and settings it is left as it is; a search that `progress` ended
    continues there. Photographs without a camera are left out. Raises `SceneRefusedError` with what to do
    where the photographs cannot be used or fit together too badly (nothing is written then), and `UsageError`
    where `out` holds something else.
    """
    settings = settings or PoseSettings()
    if out.exists() and not _is_ours(out):
        raise UsageError(
            "config.poses_folder", f'"{out}" exists and was not made by this command; choose another folder'
        )
    problems = Problems()
    photographs = find_photographs(photographs_dir, masks_dir, problems)
    if photographs is None:
        raise SceneRefusedError.of(problems.findings())
    inputs = _inputs(photographs, settings)
    known = read_record(out / RECORD)
    if known.get("inputs") == inputs:
        return known
    solution = solve_apart(photographs, out / WORK, settings, progress)
    advise(solution, PoseLimits(), problems)
    if not problems.usable:
        _clear(out)
        raise SceneRefusedError.of(problems.findings())
    _write(photographs, solution, out)
    write_json(out / RECORD, {"inputs": inputs, **_record(solution, problems)})
    shutil.rmtree(out / WORK)
    return read_record(out / RECORD)


def summary(record: dict[str, Any]) -> str:
    """Return in words how well cameras were found."""
    return (
        f"cameras for {record['registered']} of {record['photographs']} photographs, "
        f"{record['points']} points, reprojection error {measured(record['reprojection_error_px'], 2)} pixels"
    )


def _is_ours(out: Path) -> bool:
    """Return whether `out` is a capture of this command, the beginning of one, or empty."""
    if not out.is_dir():
        return False
    held = {path.name for path in out.iterdir()}
    return not held or RECORD in held or (WORK in held and held <= {WORK, IMAGES, MASKS, MODEL.parts[0]})


def _write(photographs: Photographs, solution: Solution, out: Path) -> None:
    """Write photographs, masks and model of those with a camera, in place of an earlier capture."""
    (out / RECORD).unlink(missing_ok=True)
    for folder in (IMAGES, MASKS, MODEL.parts[0]):
        shutil.rmtree(out / folder, ignore_errors=True)
    for name in sorted(solution.camera_to_world):
        target = out / IMAGES / name
        target.parent.mkdir(parents=True, exist_ok=True)
        _copy(photographs.path(name), target)
        if photographs.masked:
            write_mask(out / MASKS / f"{name}.png", photographs.coverage(name))
    assert solution.model is not None
    shutil.copytree(solution.model, out / MODEL)


def _copy(photograph: Path, target: Path) -> None:
    """Copy a photograph; one stored as a mirror image is written mirrored back, in 8-bit sRGB without EXIF.

    Its cameras are those of the picture as it was, and other programs read the file without looking at EXIF.
    """
    if photograph.suffix.lower() not in PILLOW_FORMATS or not exif_facts(photograph).is_mirrored:
        shutil.copyfile(photograph, target)
        return
    picture, known = read_picture(photograph), picture_format(photograph)
    pixels = picture.srgb()
    if picture.alpha is not None:
        pixels = np.dstack([pixels, np.round(255.0 * picture.coverage()).astype(np.uint8)])
    options: dict[str, Any] = {"quality": 97, "subsampling": 0} if known == "JPEG" else {}
    if known in ("WEBP", "AVIF"):
        options = {"lossless": True} if known == "WEBP" else {"quality": 97}
    Image.fromarray(pixels).save(target, known, **options)


def _clear(out: Path) -> None:
    """Remove what a refused search left behind, and `out` where nothing else is in it."""
    shutil.rmtree(out / WORK, ignore_errors=True)
    if not any(out.iterdir()):
        out.rmdir()


def _record(solution: Solution, problems: Problems) -> dict[str, Any]:
    return {
        "photographs": len(solution.names),
        "registered": len(solution.camera_to_world),
        "missing": [name for name in solution.names if name not in solution.camera_to_world],
        "points": solution.num_points,
        "reprojection_error_px": round(solution.reprojection_error_px, 4),
        "static_background": solution.static_background,
        "findings": [message_to_dict(finding) for finding in problems.findings()],
    }


def _inputs(photographs: Photographs, settings: PoseSettings) -> str:
    files = {name: photographs.path(name) for name in photographs.names}
    files |= {f"mask of {name}": path for name, path in photographs.masks.items()}
    contents = []
    for name, path in sorted(files.items()):
        if path.is_file():
            contents.append([name, file_sha256(path)])
    return digest(contents, asdict(settings), version("pycolmap"))
