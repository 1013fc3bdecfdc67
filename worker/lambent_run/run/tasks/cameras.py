"""Task: find the cameras of photographs that have none."""

import shutil
from dataclasses import replace
from pathlib import Path

from lambent_capture.checks.check import check_capture
from lambent_capture.checks.check_result import tell_findings
from lambent_capture.layouts.photographs import (
    CAMERAS_FILE,
    NAME,
    FoundCameras,
    FoundFinding,
    read_found_cameras,
)
from lambent_capture.masks.motion import write_motion_masks
from lambent_capture.poses.advice import PoseLimits, advise
from lambent_capture.poses.apart import solve_apart
from lambent_capture.poses.photographs import Photographs, find_photographs
from lambent_capture.poses.solution import MODEL, Solution
from lambent_capture.poses.solve import PoseSettings
from lambent_capture.problems import Problems
from lambent_core.errors import SceneRefusedError
from lambent_core.files import write_json
from lambent_core.measured import measured

from lambent_run.run.context import TaskContext
from lambent_run.run.folder import begun_inputs
from lambent_run.run.masks import given_masks

WORK = "work"
PARTS = {
    "features": ("photographs looked at", (0.0, 0.4)),
    "survey": ("pairs compared roughly", (0.4, 0.5)),
    "pairs": ("pairs matched", (0.5, 0.8)),
    "cameras": ("cameras placed", (0.8, 1.0)),
}
"""By phase of the search: what is counted, and the phase's share of the task's time."""


def run(context: TaskContext) -> None:
    """Write `cameras/sparse/0` and `cameras/cameras.json`; an interrupted search continues.

    Raises `SceneRefusedError` after reporting every finding where the photographs cannot be used, or their
    cameras are not found.
    """
    inputs = begun_inputs(context.run_dir, "cameras") or ""
    if (context.folder / CAMERAS_FILE).is_file() and read_found_cameras(context.folder).inputs == inputs:
        context.reporter.log("cameras.restored")
    else:
        _check(context)
        _find(context, inputs)
        context.reporter.checkpoint("cameras", 1, context.folder)
    cameras = read_found_cameras(context.folder)
    context.reporter.finding("scene.poses_solved", summary(cameras))
    for finding in cameras.findings:
        context.reporter.finding(finding.code, finding.message, subject=finding.subject)


def summary(cameras: FoundCameras) -> str:
    """Return in words how well cameras were found."""
    return (
        f"cameras for {cameras.registered} of {cameras.photographs} photographs, {cameras.points} points, "
        f"reprojection error {measured(cameras.reprojection_error_px, 2)} pixels"
    )


def _check(context: TaskContext) -> None:
    """Look at each photograph, unless that was done, and refuse those that cannot be used."""
    checked = context.checked
    if checked is None:
        spec = context.spec
        checked = check_capture(spec.scene, spec.layout or None, given_masks(context.run_dir, spec.masks))
        tell_findings(context.reporter, checked.report.findings)
    if not checked.report.usable:
        raise SceneRefusedError(checked.report)


def _find(context: TaskContext, inputs: str) -> None:
    """Find the cameras and write them; raises `SceneRefusedError` where too few are found."""
    spec, work = context.spec, context.folder / WORK
    # The check has told what there is to tell of the files.
    photographs = find_photographs(spec.scene, given_masks(context.run_dir, spec.masks), files := Problems())
    if photographs is None:
        raise SceneRefusedError.of(files.findings(), NAME)
    reached = 0.0

    def progress(phase: str, done: int, total: int) -> None:
        nonlocal reached
        context.stop_if_asked()
        doing, (begin, end) = PARTS[phase]
        # A further attempt begins anew, but what is done is done.
        reached = max(reached, begin + (end - begin) * done / max(total, 1))
        context.progress(done, total, doing=doing, part=(reached, reached))

    settings = PoseSettings(seed=spec.seed)
    solution = solve_apart(photographs, work, settings, progress)
    if solution.static_background and not photographs.masked:
        moving = _what_moves(photographs, work / "moving", context)
        if moving is not None:
            again = solve_apart(moving, work, settings, progress)
            solution = max(solution, again, key=lambda each: len(each.camera_to_world))
    problems = Problems()
    advise(solution, PoseLimits(), problems)
    if not problems.usable:
        shutil.rmtree(work)
        refused = SceneRefusedError.of(problems.findings(), NAME)
        tell_findings(context.reporter, refused.report.findings)
        raise refused
    _write(context, solution, problems, inputs)
    shutil.rmtree(work)


def _what_moves(photographs: Photographs, out: Path, context: TaskContext) -> Photographs | None:
    """Return the photographs with masks of what moves before a standing background, as on a turntable.

    None where nothing does.
    """
    paths = [photographs.path(name) for name in photographs.names]

    def progress(_phase: str, _done: int, _total: int) -> None:
        context.stop_if_asked()

    if write_motion_masks(paths, photographs.names, out, progress) is None:
        return None
    return replace(photographs, masks={name: out / f"{name}.png" for name in photographs.names})


def _write(context: TaskContext, solution: Solution, problems: Problems, inputs: str) -> None:
    assert solution.model is not None, "advise refuses photographs without any camera"
    shutil.rmtree(context.folder / MODEL, ignore_errors=True)
    shutil.copytree(solution.model, context.folder / MODEL)
    cameras = FoundCameras(
        inputs=inputs,
        photographs=len(solution.names),
        missing=tuple(name for name in solution.names if name not in solution.camera_to_world),
        points=solution.num_points,
        reprojection_error_px=round(solution.reprojection_error_px, 4),
        up=solution.up,
        static_background=solution.static_background,
        findings=tuple(
            FoundFinding(code=finding.code, message=finding.message, subject=finding.subject)
            for finding in problems.findings()
            if finding.code != "scene.static_background"  # told by `ingest`, with what is done about it
        ),
    )
    write_json(context.folder / CAMERAS_FILE, cameras.model_dump(mode="json"))
