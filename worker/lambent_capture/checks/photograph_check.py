"""The check of photographs whose cameras are not known yet: each for itself, and whether they differ."""

from collections.abc import Callable, Mapping
from pathlib import Path

from lambent_core.layouts import PHOTOGRAPHS
from lambent_proto.v1 import capture_pb2, scene_pb2

from lambent_capture.checks.check_result import CaptureCheck
from lambent_capture.checks.photograph_findings import note_photographs
from lambent_capture.checks.photograph_limits import PhotographLimits
from lambent_capture.checks.photographs import PhotographsFigures, look
from lambent_capture.layouts.detect import collect_scene
from lambent_capture.layouts.unread_formats import note_unread
from lambent_capture.loading.inspect import note_unsupported
from lambent_capture.pictures.picture_error import NOTHING_SKIPPED
from lambent_capture.problems import Problems

SCHEMA_VERSION = "1.0"


def check_photographs(
    folder: Path,
    masks: Path | None,
    skip: Mapping[str, str] = NOTHING_SKIPPED,
    announce: Callable[[str], None] = lambda path: None,
) -> CaptureCheck:
    """Return what is to be said of the photographs in `folder` after decoding each of them once.

    `masks` is a folder of masks named like them; `skip` and `announce` as in `inspect.inspect_files`. The
    cameras are not looked for.
    """
    problems = Problems()
    manifest = collect_scene(folder, PHOTOGRAPHS, problems, masks)
    note_unsupported(folder, set(), problems)
    note_unread(folder, problems)
    frames = [] if manifest is None else list(manifest.frames)
    names = {frame.images[0].path: frame.name for frame in frames}
    seen = None
    if problems.usable:
        seen = look(folder, list(names), PhotographLimits(), announce, skip)
        note_photographs(seen, problems)
    usable = problems.usable and seen is not None
    report = scene_pb2.SceneReport(
        usable=usable,
        layout=PHOTOGRAPHS,
        findings=problems.findings(),
        num_train_frames=len(frames) - (len(seen.left_out) if seen is not None else 0),
    )
    if seen is None or not usable:
        return CaptureCheck(report=report)
    masked = any(frame.mask for frame in frames)
    figures = _figures(seen, names, masked=masked)
    thumbnails = {names[path]: jpeg for path, jpeg in seen.thumbnails.items()}
    return CaptureCheck(
        report=report,
        figures=figures,
        thumbnails=thumbnails,
        portrait=seen.portrait,
        left_out=seen.left_out,
    )


def _figures(
    seen: PhotographsFigures, names: Mapping[str, str], *, masked: bool
) -> capture_pb2.CaptureFigures:
    usable = seen.usable
    figures = capture_pb2.CaptureFigures(
        schema_version=SCHEMA_VERSION,
        num_train_views=len(usable),
        lacks_cameras=True,
        has_masks=masked or all(each.has_alpha for each in usable),
        exposure_range_ev=seen.exposure_range_ev,
    )
    for each in usable:
        picture = capture_pb2.PictureFigures(
            path=each.name, clipped_share=each.clipped_share, sharpness=each.sharpness
        )
        figures.views.add(
            name=names[each.name], split=scene_pb2.SPLIT_TRAIN, moved_share=1.0, pictures=[picture]
        )
    return figures
