"""A job of the kind `prepare`: cameras and masks, to be looked at and corrected; nothing is trained.

Where the server offers the estimate of an earlier job of the scene, its corrections need neither photographs
nor torch: fetching the one and importing the other would take most of the time that a person waits.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from lambent_capture.checks.check_result import tell_findings
from lambent_core.errors import SceneRefusedError, Stopped, UsageError
from lambent_core.files import read_record
from lambent_core.reporter import Reporter
from lambent_proto.v1 import job_pb2, worker_pb2

from lambent_run.job.connection import Connection, RefusedError
from lambent_run.run.folder import done_inputs, task_folder
from lambent_run.run.kept import MADE_FROM, WORKSPACE, is_made_from
from lambent_run.run.parameters import JobParameters
from lambent_run.run.preparation import cameras_hash, files_hash, ingest_hash

if TYPE_CHECKING:
    from lambent_capture.masks.corrections import Correction

    from lambent_run.job.order import Order

KIND = "prepare"
ARTIFACTS = "preparation"
"""What the names of the previews begin with."""
_STEPS = ("reading the estimate", "applying corrections", "drawing outlines", "sending previews")


def show_kept(
    connection: Connection,
    reporter: Reporter,
    start: worker_pb2.StartResponse,
    parameters: JobParameters,
    run_dir: Path,
) -> bool:
    """Publish previews of the estimate that the server offers, with the order's corrections applied.

    Returns False, having published nothing, where it offers none that fits the order.
    """
    kept = next((each for each in reversed(start.checkpoints) if each.stage == "masks"), None)
    # Parameters that name files of the capture need it to know what they are.
    if kept is None or start.check_scene or parameters.known_lights or parameters.masks:
        return False
    folder = task_folder(run_dir, "masks") / WORKSPACE
    inside = f"{folder.relative_to(run_dir).as_posix()}/"
    files = {file.path: file for file in kept.files if file.path.startswith(inside)}
    try:
        record = files.pop(inside + MADE_FROM)
        connection.get_file(record.sha256, run_dir / record.path)
        if read_record(folder / MADE_FROM).get("sha256") not in _ingest_hashes(start, parameters):
            reporter.log("masks.kept_do_not_fit")
            return False
        _tell(reporter, 0, before=0.0)
        for file in files.values():
            connection.get_file(file.sha256, run_dir / file.path)
    except (KeyError, RefusedError, OSError) as error:
        reporter.log("masks.kept_are_broken", reason=str(error))
        return False
    _publish_estimate(folder, parameters.corrections, reporter, run_dir / ARTIFACTS, before=0.0)
    return True


def run_prepare(order: "Order") -> None:
    """Find cameras and masks, and publish previews with the order's corrections applied.

    Masks that are not credible do not end such a job as long as a person can correct them; the previews say
    why. Raises `SceneRefusedError` for an unusable capture, `UsageError` for corrections that have no effect.
    """
    from lambent_run.run.hashes import PREPARATION
    from lambent_run.run.pipeline import run_pipeline
    from lambent_run.run.spec import RunSpec

    corrections = order.parameters.corrections
    spec = RunSpec.from_job(order.start, replace(order.parameters, corrections=()), order.scene_dir)
    workspace = task_folder(order.run_dir, "masks") / WORKSPACE
    try:
        run_pipeline(
            spec, order.run_dir, order.start.device, order.reporter, PREPARATION, checked=order.checked
        )
    except SceneRefusedError as refusal:
        if not is_made_from(workspace, done_inputs(order.run_dir, "ingest") or ""):
            raise
        tell_findings(order.reporter, refusal.report.findings)
        order.reporter.checkpoint("masks", 1, workspace)
    out = order.run_dir / ARTIFACTS
    if is_made_from(workspace, done_inputs(order.run_dir, "ingest") or ""):
        _publish_estimate(workspace, corrections, order.reporter, out, before=1.0)
        return
    if corrections:
        raise UsageError(
            "config.corrections_invalid",
            "the corrections are about masks that are estimated, but this capture brings its own; leave "
            "them out",
        )
    _publish_given(order, out)


def _ingest_hashes(start: worker_pb2.StartResponse, parameters: JobParameters) -> set[str]:
    """Return what an estimate may say it was made from if it fits the order.

    Files of a scene never change, so the one that a kept estimate names is right: with cameras that were
    found, or with those of the capture.
    """
    scene = files_hash((file.path, file.sha256) for file in start.files)
    return {
        ingest_hash(
            scene,
            lights=parameters.lights,
            layout=parameters.layout,
            known_lights={},
            masks="",
            cameras=cameras,
            light_fixed_to=parameters.light_fixed_to,
        )
        for cameras in (cameras_hash(scene, start.seed), None)
    }


def _publish_estimate(
    workspace: Path, corrections: Sequence["Correction"], reporter: Reporter, out: Path, *, before: float
) -> None:
    """Publish previews; `before` is the share of the job that is done before."""
    from lambent_capture.masks.preview import write_estimated
    from lambent_capture.masks.propagate import propagated
    from lambent_capture.masks.workspace import Workspace

    work = Workspace.load(workspace)
    _tell(reporter, 1, before)
    work = propagated(work, corrections)
    _tell(reporter, 2, before)
    write_estimated(work, out)
    _send(reporter, out, before)


def _publish_given(order: "Order", out: Path) -> None:
    from lambent_capture.masks.preview import write_given

    from lambent_run.run.capture import read_manifest
    from lambent_run.run.prepare import open_task

    manifest = read_manifest(open_task(order.run_dir, "masks", order.reporter))
    write_given(order.scene_dir, manifest, out)
    _send(order.reporter, out, before=1.0)


def _send(reporter: Reporter, out: Path, before: float) -> None:
    from lambent_capture.masks.folder import SHEET

    _tell(reporter, 3, before)
    for path in sorted(path for path in out.rglob("*") if path.is_file()):
        name = path.relative_to(out).as_posix()
        reporter.artifact(name if name == SHEET else f"{ARTIFACTS}/{name}", path)


def _tell(reporter: Reporter, step: int, before: float) -> None:
    """Tell what is being done; raises `Stopped` where the run was asked to end."""
    if reporter.should_stop():
        raise Stopped
    progress = job_pb2.Progress(stage="masks", step=step, num_steps=len(_STEPS), doing=_STEPS[step])
    progress.fraction = before + (1.0 - before) * step / len(_STEPS)
    reporter.progress(progress)
