"""Task: find the cameras of photographs that have none."""

import shutil

from lambent_worker.capture_qa.check import check_capture
from lambent_worker.capture_qa.check_result import tell_findings
from lambent_worker.errors import SceneRefusedError
from lambent_worker.files import write_json
from lambent_worker.poses.capture import solve_capture
from lambent_worker.poses.solve import PoseSettings
from lambent_worker.run.context import TaskContext
from lambent_worker.run.folder import begun_inputs
from lambent_worker.run.masks import given_masks
from lambent_worker.scenes.photographs import CAMERAS_FILE, FoundCameras, read_found_cameras


def run(context: TaskContext) -> None:
    """Write `cameras/sparse/0` and `cameras/cameras.json`; a search that was interrupted goes on.

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
    found = read_found_cameras(context.folder)
    context.reporter.finding("scene.poses_solved", summary(found))
    for finding in found.findings:
        context.reporter.finding(finding.code, finding.message, subject=finding.subject)


def summary(found: FoundCameras) -> str:
    """Return in words how well cameras were found."""
    return (
        f"cameras for {found.registered} of {found.photographs} photographs, {found.points} points, "
        f"reprojection error {found.reprojection_error_px:.2f} pixels"
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
    spec, work = context.spec, context.folder / "work"

    def tell(text: str) -> None:
        context.stop_if_asked()
        context.reporter.log("cameras.search", doing=text)

    record = solve_capture(
        spec.scene, work, given_masks(context.run_dir, spec.masks), PoseSettings(seed=spec.seed), tell
    )
    shutil.rmtree(context.folder / "sparse", ignore_errors=True)
    shutil.copytree(work / "sparse", context.folder / "sparse")
    found = FoundCameras.model_validate({**record, "inputs": inputs})
    write_json(context.folder / CAMERAS_FILE, found.model_dump(mode="json"))
    shutil.rmtree(work)
