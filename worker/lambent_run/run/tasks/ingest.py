"""Task: make sure the capture can be used, and write down what it is."""

from lambent_capture.checks.check import check_capture
from lambent_capture.checks.check_result import tell_findings
from lambent_capture.checks.page import write_capture_report
from lambent_capture.layouts.detect import describe_scene
from lambent_capture.loading.lights import select_lights
from lambent_core.errors import SceneRefusedError
from lambent_core.files import file_sha256, write_json
from lambent_core.messages import message_to_dict

from lambent_run.run.capture import LEFT_OUT, MANIFEST, even_out, found_cameras, own_masks, settle_light
from lambent_run.run.context import TaskContext
from lambent_run.run.masks import AUTOMATIC, given_masks


def run(context: TaskContext) -> None:
    """Write `scene/manifest.json` with the chosen lights, and all findings to `scene/capture.json`, `.html`.

    Raises `SceneRefusedError` after reporting every finding when the capture cannot be used, and `UsageError`
    for a grey card that is in none of its photographs.
    """
    spec = context.spec
    layout, given = spec.layout or None, given_masks(context.run_dir, spec.masks)
    cameras = found_cameras(context.run_dir) if spec.lacks_cameras else None
    told = [] if context.checked is None else list(context.checked.report.findings)
    checked = context.checked
    if checked is None or layout is not None or given is not None or cameras is not None:
        checked = check_capture(spec.scene, layout, given, cameras)
    # The task `masks` tells of masks that are missing.
    hidden = ("scene.no_mask",) if spec.masks == AUTOMATIC else ()
    fresh = (each for each in checked.report.findings if each not in told and each.code not in hidden)
    tell_findings(context.reporter, fresh)
    write_capture_report(context.folder, spec.scene.name, checked)
    if not checked.report.usable:
        raise SceneRefusedError(checked.report)
    left_out = {path: file_sha256(spec.scene / path) for path in checked.left_out}
    write_json(context.folder / LEFT_OUT, left_out)
    manifest = describe_scene(spec.scene, layout, given, checked.left_out, cameras)
    manifest = select_lights(manifest, spec.lights)
    if spec.grey_card is not None:
        # Here, since it imports torch, which photographs are prepared without.
        from lambent_run.run.card_pixels import box_turns, frame_of

        box_turns(spec.grey_card, frame_of(spec.grey_card, manifest)[0], manifest)
    settle_light(context, manifest)
    if checked.figures is not None and checked.figures.has_masks:
        even_out(context, manifest, checked.figures)
    if own_masks(context) is not None:  # Found by name when they are needed, since a run may be moved.
        for frame in manifest.frames:
            frame.mask = ""
    write_json(context.folder / MANIFEST, message_to_dict(manifest))
    context.progress(1, 1)
