"""First task: make sure the capture can be used, and write down what it is."""

from pathlib import Path

import numpy as np
from lambent_proto.v1 import capture_pb2, scene_pb2

from lambent_worker.capture_qa.check import check_capture
from lambent_worker.capture_qa.check_result import tell_findings
from lambent_worker.capture_qa.examine import examine_capture
from lambent_worker.capture_qa.exposure_estimate import even_out_exposure
from lambent_worker.capture_qa.limits import CaptureLimits
from lambent_worker.capture_qa.page import build_page
from lambent_worker.errors import SceneRefusedError
from lambent_worker.files import write_json
from lambent_worker.messages import message_to_dict, read_message
from lambent_worker.run.context import TaskContext
from lambent_worker.run.folder import task_folder
from lambent_worker.run.masks import AUTOMATIC, given_masks
from lambent_worker.scenes.detect import describe_scene, fit_to_masks
from lambent_worker.scenes.lights import select_lights
from lambent_worker.scenes.mask_folder import attach_masks
from lambent_worker.scenes.problems import Problems

ESTIMATED_FOLDER = "masks"


def run(context: TaskContext) -> None:
    """Write `scene/manifest.json` with the chosen lights, `scene/report.json` with all findings, and a page.

    Where nothing says where the object is, `scene/masks/` is estimated, with thumbnails in `scene/masks.jpg`.
    Raises `SceneRefusedError` after reporting every finding when the capture cannot be used, and where the
    estimate is not to be believed.
    """
    spec = context.spec
    layout, given = spec.layout or None, given_masks(context.run_dir, spec.masks)
    told = [] if context.checked is None else context.checked.report.findings
    checked = context.checked
    if checked is None or layout is not None or given is not None:
        checked = check_capture(spec.scene, layout, given)
    report = checked.report
    tell_findings(context.reporter, (finding for finding in report.findings if finding not in told))
    write_json(context.folder / "report.json", message_to_dict(report))
    page = build_page(spec.scene.name, checked, CaptureLimits())
    (context.folder / "capture.html").write_text(page, encoding="utf-8")
    if not report.usable:
        raise SceneRefusedError(report)
    manifest, figures = describe_scene(spec.scene, layout, given), checked.figures
    estimates = spec.masks == AUTOMATIC and figures is not None and not figures.has_masks
    if estimates:
        estimated = _estimate(context, select_lights(manifest, spec.lights))
        _attach_or_refuse(manifest, spec.scene, estimated)
        fit_to_masks(spec.scene, manifest)
    manifest = select_lights(manifest, spec.lights)
    if estimates:  # what is measured on the object needs to know where it is
        figures = examine_capture(spec.scene, manifest, CaptureLimits()).figures
    if figures is not None:
        _even_out(context, manifest, figures)
    if own_masks(context) is not None:  # Found by name when they are needed, since a run may be moved.
        for frame in manifest.frames:
            frame.mask = ""
    write_json(context.folder / "manifest.json", message_to_dict(manifest))
    context.progress(1, 1)


def _estimate(context: TaskContext, manifest: scene_pb2.SceneManifest) -> Path:
    from lambent_worker.masks.folder import write_masks

    def progress(done: int, total: int) -> None:
        context.stop_if_asked()
        context.progress(done, total + 1)

    written = write_masks(context.spec.scene, manifest, context.folder, progress=progress)
    doubtful = f" (least sure of {', '.join(written.doubtful[:3])})" if written.doubtful else ""
    context.reporter.finding(
        "scene.mask_estimated",
        f"no picture says where the object is, so it was estimated; the views agree to "
        f"{100.0 * written.overlap:.0f} %{doubtful}; look at {written.sheet}, and give better ones with "
        "--masks",
    )
    context.reporter.artifact("masks.jpg", written.sheet)
    return written.folder


def _even_out(
    context: TaskContext, manifest: scene_pb2.SceneManifest, figures: capture_pb2.CaptureFigures
) -> None:
    """Estimate exposures where they are not known, and tell the findings."""
    problems = Problems()
    even_out_exposure(manifest, figures, problems)
    for finding in problems.findings():
        context.reporter.finding(finding.code, finding.message)


def own_masks(context: TaskContext) -> Path | None:
    """Return the folder of the run's own masks, given or estimated, or None where the capture's are used."""
    estimated = task_folder(context.run_dir, "ingest") / ESTIMATED_FOLDER
    given = given_masks(context.run_dir, context.spec.masks)
    return given if given is not None else estimated if estimated.is_dir() else None


def use_own_masks(
    context: TaskContext,
    folder: Path,
    manifest: scene_pb2.SceneManifest,
    trained: scene_pb2.SceneManifest,
) -> None:
    """Give the frames of the capture in `folder` the run's own masks if the run was trained on them.

    Both manifests are in one world. Frames of another capture have other names or poses, and keep what they
    say themselves. Raises `SceneRefusedError` where a mask is missing or does not fit its photograph.
    """
    masks = own_masks(context)
    poses = {frame.name: frame.camera.camera_to_world for frame in trained.frames}
    if masks is None or not all(
        frame.name in poses and np.allclose(frame.camera.camera_to_world, poses[frame.name], atol=1e-3)
        for frame in manifest.frames
    ):
        return
    _attach_or_refuse(manifest, folder, masks)


def read_manifest(context: TaskContext) -> scene_pb2.SceneManifest:
    """Return the manifest that `run` wrote into the run folder, with the run's own masks."""
    path = task_folder(context.run_dir, "ingest") / "manifest.json"
    manifest = read_message(path, scene_pb2.SceneManifest())
    masks = own_masks(context)
    if masks is not None:
        _attach_or_refuse(manifest, context.spec.scene, masks)
    return manifest


def _attach_or_refuse(manifest: scene_pb2.SceneManifest, folder: Path, masks: Path) -> None:
    problems = Problems()
    attach_masks(manifest, folder, masks, problems)
    if not problems.usable:
        raise SceneRefusedError.of(problems.findings())
