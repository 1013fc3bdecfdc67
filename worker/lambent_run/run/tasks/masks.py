"""Task: cut the object out, where nothing says where it is."""

from pathlib import Path

from lambent_capture.checks.check import check_capture
from lambent_capture.checks.check_result import CaptureCheck, tell_findings
from lambent_capture.checks.page import write_capture_report
from lambent_capture.layouts.colmap_model import ModelError
from lambent_capture.layouts.detect import fit_to_masks
from lambent_capture.layouts.photographs import read_found_cameras
from lambent_capture.masks.find import FindSettings, find_object
from lambent_capture.masks.folder import SHEET, WrittenMasks, draw_into
from lambent_capture.masks.photograph import Photograph, photographs_of
from lambent_capture.masks.sparse import sparse_points
from lambent_capture.masks.workspace import Workspace
from lambent_core.errors import WorkerError
from lambent_core.files import write_json
from lambent_core.measured import measured
from lambent_core.messages import message_to_dict
from lambent_proto.v1 import scene_pb2

from lambent_run.run.capture import (
    MANIFEST,
    MASKS,
    attach_or_refuse,
    even_out,
    found_cameras,
    needs_masks,
    read_checked_manifest,
)
from lambent_run.run.context import TaskContext
from lambent_run.run.folder import begun_inputs, done_inputs
from lambent_run.run.kept import WORKSPACE, is_made_from, note_made_from
from lambent_run.run.masks import AUTOMATIC
from lambent_run.run.spec import unused_corrections

PARTS = {
    "looking for points": (0.0, 0.12),
    "placing points": (0.12, 0.16),
    "reading photographs": (0.16, 0.26),
    "looking at the support": (0.26, 0.34),
    "comparing the views": (0.34, 0.5),
    "drawing outlines": (0.5, 0.9),
}
"""Shares of the task's time by phase of the estimate."""
AGREEMENT = "agreement.json"
"""How well the views agree, and which ones do not."""
BLAMED = frozenset(
    {
        "scene.pose_inconsistent",
        "scene.poses_inconsistent",
        "scene.silhouettes_disagree",
        "scene.mask_disagrees",
        "scene.mask_leak",
        "scene.mask_incomplete",
        "scene.mask_specks",
        "scene.mask_border",
    }
)
"""Findings about silhouettes, whatever they blame."""


def run(context: TaskContext) -> None:
    """Write `estimated_masks/`, where there are none: masks, thumbnails, the manifest with a fitted box.

    A person's corrections are applied to what was estimated, which is kept and not estimated again for other
    corrections. The result is checked like masks that a user made. Raises `SceneRefusedError` where it is
    not credible; the thumbnails show why. Raises `UsageError` for corrections of masks that are not
    estimated.
    """
    if context.spec.masks != AUTOMATIC or not needs_masks(context):
        if context.spec.corrections:
            raise unused_corrections("this capture brings its own")
        return
    folder = context.folder / MASKS
    inputs = begun_inputs(context.run_dir, "masks") or ""
    if not is_made_from(context.folder, inputs):
        (context.folder / MANIFEST).unlink(missing_ok=True)
        written = _draw(context)
        _tell(context, written)
        manifest = read_checked_manifest(context)
        attach_or_refuse(manifest, context.spec.scene, folder)
        fit_to_masks(context.spec.scene, manifest)
        checked = _check(context, folder)
        if checked.figures is not None:
            even_out(context, manifest, checked.figures)
        for frame in manifest.frames:
            frame.mask = ""
        write_json(context.folder / MANIFEST, message_to_dict(manifest))
        note_made_from(context.folder, inputs)
        context.reporter.checkpoint("masks", 1, context.folder)
    else:
        context.reporter.log("masks.restored")
    context.reporter.artifact(SHEET, context.folder / SHEET)
    context.progress(1, 1)


def photographs(context: TaskContext) -> list[Photograph]:
    """Return the photographs of the run's capture, in the order of its workspace."""
    return photographs_of(context.spec.scene, read_checked_manifest(context))


def found_object(context: TaskContext) -> Workspace | str:
    """Return where the object is before corrections, or why these views cannot be compared.

    What was found once is kept in `workspace/`, and read from there as long as the capture is the same.
    """
    kept, inputs = context.folder / WORKSPACE, done_inputs(context.run_dir, "ingest") or ""
    if is_made_from(kept, inputs):
        try:
            return Workspace.load(kept)
        except WorkerError as error:  # Of another release.
            context.reporter.log("masks.estimated_again", reason=error.code)
    workspace = _find(context)
    if not isinstance(workspace, str):
        workspace.save(kept)
        note_made_from(kept, inputs)
    return workspace


def _find(context: TaskContext) -> Workspace | str:
    spec, manifest, points = context.spec, read_checked_manifest(context), None
    try:
        points = sparse_points(spec.scene, manifest, found_cameras(context.run_dir))
    except ModelError as error:
        context.reporter.finding(
            "scene.points_unreadable",
            f"the points of the sparse model cannot be used ({error}), so the table under the object is not "
            "found by them; export the model again",
        )
    cameras = found_cameras(context.run_dir)
    still = cameras is not None and read_found_cameras(cameras).static_background
    return find_object(
        photographs_of(spec.scene, manifest),
        points,
        FindSettings(),
        lambda *step: _progress(context, *step),
        still_background=still,
    )


def _draw(context: TaskContext) -> WrittenMasks:
    workspace = found_object(context)
    corrections = context.spec.corrections
    written = draw_into(
        workspace, photographs(context), context.folder, corrections, lambda *step: _progress(context, *step)
    )
    if written.reason:
        context.reporter.artifact(SHEET, written.sheet)
    written.require_credible()
    agreement = {"overlap": round(written.overlap, 4), "doubtful": list(written.doubtful)}
    write_json(context.folder / AGREEMENT, agreement)
    return written


def _progress(context: TaskContext, phase: str, done: int, total: int) -> None:
    context.stop_if_asked()
    context.progress(done, total, doing=phase, part=PARTS[phase])


def _tell(context: TaskContext, written: WrittenMasks) -> None:
    doubtful = f" (least sure of {', '.join(written.doubtful[:3])})" if written.doubtful else ""
    corrected = " and corrected by hand" if context.spec.corrections else ""
    context.reporter.finding(
        "scene.mask_estimated",
        f"no picture says where the object is, so it was estimated{corrected}; the views agree to "
        f"{measured(100.0 * written.overlap)} %{doubtful}; look at {SHEET}, and correct it with lambent "
        "masks --edit or give better ones with --masks",
    )


def _check(context: TaskContext, masks: Path) -> CaptureCheck:
    """Return a check of the capture with the estimated masks, after telling what that adds."""
    spec = context.spec
    checked = check_capture(spec.scene, spec.layout or None, masks, found_cameras(context.run_dir))
    write_capture_report(context.folder, spec.scene.name, checked)
    tell_findings(context.reporter, blaming_masks(checked))
    return checked


def blaming_masks(checked: CaptureCheck) -> list[scene_pb2.Finding]:
    """Return what a check says of masks that we made: a silhouette that does not fit is their fault.

    Poses were judged before, by the points that they were found from.
    """
    findings = []
    for finding in checked.report.findings:
        if finding.code in BLAMED:
            advice = "correct its mask (lambent masks --edit)"
            findings.append(
                scene_pb2.Finding(
                    code="scene.mask_doubtful",
                    severity=scene_pb2.SEVERITY_WARNING,
                    message=f"{finding.message.rsplit('; ', 1)[0]}; {advice}",
                    subject=finding.subject,
                )
            )
    return findings
