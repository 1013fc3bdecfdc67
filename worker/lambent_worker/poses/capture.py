"""Turns a folder of photographs into a capture of the layout `colmap`."""

import shutil
from collections.abc import Callable
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

from lambent_worker.errors import SceneRefusedError, UsageError
from lambent_worker.files import digest, file_sha256, read_record, write_json
from lambent_worker.messages import message_to_dict
from lambent_worker.poses.advice import PoseLimits, advise
from lambent_worker.poses.photographs import Photographs, find_photographs, lay_out
from lambent_worker.poses.solve import PoseSettings, Solution, load_colmap, solve
from lambent_worker.scenes.problems import Problems

RECORD = "poses.json"


def solve_capture(
    photographs_dir: Path,
    out: Path,
    masks_dir: Path | None = None,
    settings: PoseSettings | None = None,
    tell: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """Write a capture to `out` with the photographs whose cameras were found, and return its `poses.json`.

    That has photographs, registered, missing, points, reprojection_error_px and findings. Where `out` was
    made from the same photographs, masks and settings it is left as it is. Photographs without a camera are
    left out. Raises `SceneRefusedError` with what to do where the photographs cannot be used or fit together
    too badly (nothing is written then), and `UsageError` where `out` holds something else or pycolmap is
    missing.
    """
    settings = settings or PoseSettings()
    load_colmap()
    if out.exists() and not (out / RECORD).is_file() and (not out.is_dir() or any(out.iterdir())):
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
    partial = out.with_name(out.name + ".partial")
    shutil.rmtree(partial, ignore_errors=True)
    try:
        record = _fill(photographs, partial, settings, problems, tell)
        write_json(partial / RECORD, {"inputs": inputs, **record})
        shutil.rmtree(out, ignore_errors=True)
        partial.rename(out)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    return read_record(out / RECORD)


def summary(record: dict[str, Any]) -> str:
    """Return in words how well cameras were found."""
    return (
        f"cameras for {record['registered']} of {record['photographs']} photographs, "
        f"{record['points']} points, reprojection error {record['reprojection_error_px']:.2f} pixels"
    )


def _fill(
    photographs: Photographs,
    folder: Path,
    settings: PoseSettings,
    problems: Problems,
    tell: Callable[[str], None],
) -> dict[str, Any]:
    given = lay_out(photographs, folder, problems)
    if not problems.usable:
        raise SceneRefusedError.of(problems.findings())
    work = folder / "work"
    work.mkdir()
    solution = solve(
        folder,
        tuple(given.values()),
        work,
        settings,
        masked=bool(photographs.masks) or photographs.cut_out,
        one_camera=photographs.one_size,
        tell=tell,
    )
    shutil.rmtree(work)
    advise(solution, PoseLimits(), problems)
    if not problems.usable:
        raise SceneRefusedError.of(problems.findings())
    _leave_out(solution, folder)
    return {
        "photographs": len(solution.names),
        "registered": len(solution.camera_to_world),
        "missing": [name for name in solution.names if name not in solution.camera_to_world],
        "points": solution.num_points,
        "reprojection_error_px": round(solution.reprojection_error_px, 4),
        "findings": [message_to_dict(finding) for finding in problems.findings()],
    }


def _leave_out(solution: Solution, folder: Path) -> None:
    """Remove the photographs without a camera, which no frame of the capture would use."""
    for name in solution.names:
        if name not in solution.camera_to_world:
            (folder / "images" / name).unlink()
            (folder / "masks" / f"{name}.png").unlink(missing_ok=True)


def _inputs(photographs: Photographs, settings: PoseSettings) -> str:
    files = {name: photographs.path(name) for name in photographs.names}
    files |= {f"mask of {name}": path for name, path in photographs.masks.items()}
    contents = []
    for name, path in sorted(files.items()):
        if path.is_file():
            contents.append([name, file_sha256(path)])
    return digest(contents, asdict(settings), version("pycolmap"))
