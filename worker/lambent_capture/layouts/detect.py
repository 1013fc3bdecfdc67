"""Detects the layout of a folder and describes it as a `SceneManifest`."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

import numpy as np
from lambent_core.errors import SceneRefusedError, UsageError
from lambent_core.layouts import LAYOUTS, PHOTOGRAPHS, Layout
from lambent_proto.v1 import scene_pb2

from lambent_capture.arrays import Pose64
from lambent_capture.layouts import camera_places, photographs
from lambent_capture.layouts.mask_folder import attach_masks, attach_masks_beside
from lambent_capture.layouts.readers import reader_of
from lambent_capture.layouts.unread_formats import note_only_unread
from lambent_capture.problems import Problems
from lambent_capture.scenes.capture import Capture
from lambent_capture.scenes.exposure import set_exposures
from lambent_capture.scenes.extent import hold_out, set_extent
from lambent_capture.scenes.frames import check_names, report_extra_files
from lambent_capture.scenes.links import refuse_links, settle_linked
from lambent_capture.scenes.lost_frames import settle_lost, without_pictures
from lambent_capture.scenes.rig import check_rig
from lambent_capture.scenes.silhouette_check import fit_to_silhouettes, training_silhouettes
from lambent_capture.scenes.world import bring_near, settle, stand_upright

SCHEMA_VERSION = "1.0"


def detect_layout(folder: Path, *, look_deeper: bool = True) -> str | None:
    """Return the name of the layout of `folder`, or None where it is none we know.

    With `look_deeper` a capture may lie in a folder of it, if that is the only one.
    """
    if not folder.is_dir():
        return None
    with_cameras = (name for name, layout in LAYOUTS.items() if not layout.finds_cameras)
    layout = next((name for name in with_cameras if reader_of(name).is_layout(folder)), None)
    if layout is None and look_deeper:
        layout = camera_places.deeper_layout(folder)
    return layout or (PHOTOGRAPHS if photographs.is_layout(folder) else None)


def require_layout(layout: str | None) -> None:
    """Raise `UsageError` for a name that is not in `LAYOUTS`; None is to detect it."""
    if layout is not None and layout not in LAYOUTS:
        raise UsageError(
            "scene.layout_unknown",
            f'--layout "{layout}" is none of {", ".join(LAYOUTS)}; choose one of these',
        )


def collect_scene(
    folder: Path,
    layout: str | None,
    problems: Problems,
    masks: Path | None = None,
    broken: Mapping[str, scene_pb2.Finding] = MappingProxyType({}),
    cameras: Path | None = None,
) -> scene_pb2.SceneManifest | None:
    """Return the manifest of all that is readable in `folder`; all problems are added to `problems`.

    `layout` forces a reader instead of detecting one; a name that is not in `LAYOUTS` is a `UsageError`.
    `masks` is a folder of masks that override those of the layout, `cameras` one of cameras that were found
    for photographs. Photographs whose cameras are not found yet have frames without cameras, and no bounds.
    `broken` says what is wrong with pictures that cannot be decoded. In tolerant layouts frames whose
    pictures are missing or broken are left out with a note, as long as they are few.
    """
    layout = _readable_layout(folder, layout, problems)
    capture = None if layout is None else _read_capture(folder, layout, problems, cameras)
    if layout is None or capture is None:
        return None
    known = LAYOUTS[layout]
    capture.frames = without_pictures(capture.frames, broken, problems)
    if known.tolerant:
        capture.other_files |= settle_lost(capture.frames, problems)
        if masks is None:
            attach_masks_beside(capture.frames, folder, problems)
    if not capture.frames:
        if problems.usable:
            check_rig([], problems)
        return None
    if capture.has_cameras:
        hold_out(capture.frames)
    check_names(capture.frames, problems)
    moved = _check_cameras(folder, capture, known, problems) if capture.has_cameras else np.eye(4)
    manifest = scene_pb2.SceneManifest(
        schema_version=SCHEMA_VERSION,
        name=capture.name,
        layout=layout,
        lights=capture.lights,
        relight_lights=capture.relight_lights,
        frames=capture.frames,
    )
    if not np.array_equal(moved, np.eye(4)):
        manifest.world_from_capture[:] = moved.ravel().tolist()
    if masks is not None:
        attach_masks(manifest, folder, masks, problems)
    if capture.has_cameras and problems.usable:
        if not capture.up_is_z:
            stand_upright(manifest, problems, capture.up)
        set_extent(manifest, capture)
        settle(manifest)
    return manifest


def _readable_layout(folder: Path, layout: str | None, problems: Problems) -> str | None:
    """Return the layout of a folder, or None after noting why nothing in it can be read."""
    require_layout(layout)
    if not folder.is_dir():
        problems.error(
            "scene.folder_missing", f'"{folder.name}" is not a folder; give the folder of a capture'
        )
        return None
    layout = layout or detect_layout(folder)
    tolerant = layout is not None and LAYOUTS[layout].tolerant
    if not tolerant and not refuse_links(folder, problems):
        return None
    if layout is None and note_only_unread(folder, problems):
        looked_for = "; ".join(f"{known.looks_like} ({name})" for name, known in LAYOUTS.items())
        problems.error(
            "scene.layout_unknown",
            f"none of these was found: {looked_for}; see docs/howto/own-photographs.md",
        )
    return layout


def _read_capture(folder: Path, layout: str, problems: Problems, cameras: Path | None) -> Capture | None:
    """Return what the reader of a layout makes of a folder; None where it needs files behind links out."""
    known = LAYOUTS[layout]
    if known.finds_cameras:
        capture = photographs.read_capture(folder, problems, cameras)
        if cameras is None:
            camera_places.note_passed_over(folder, problems)
    elif known.nested:
        place = camera_places.place_of(folder, layout)
        capture = reader_of(layout).read_capture(folder, problems, place)
        camera_places.note_deeper(place, layout, problems)
    else:
        capture = reader_of(layout).read_capture(folder, problems)
    return None if known.nested and not settle_linked(folder, problems) else capture


def _check_cameras(folder: Path, capture: Capture, known: Layout, problems: Problems) -> Pose64:
    """Check the cameras of a capture together, after bringing them near the origin by the returned matrix."""
    if problems.usable:  # else a picture may be left over because its camera is what is wrong
        report_extra_files(folder, capture.frames, capture.other_files, problems)
    moved = np.eye(4) if known.fixed_world else bring_near(capture, problems)
    check_rig(capture.frames, problems, found_here=known.finds_cameras)
    set_exposures(folder, capture.frames, capture.exposures, problems)
    return moved


def describe_scene(
    folder: Path,
    layout: str | None = None,
    masks: Path | None = None,
    left_out: Sequence[str] = (),
    cameras: Path | None = None,
) -> scene_pb2.SceneManifest:
    """Return the description of the capture in `folder`, all lights included.

    `masks` is a folder of masks that override those of the layout, `cameras` one of cameras that were found
    for photographs; `left_out` names pictures that a check could not decode, `CaptureCheck.left_out`. Where
    there are masks they say where the object is. Raises `SceneRefusedError` with every problem that the
    files' names, headers, cameras and masks show, and for photographs without cameras; other pixels are
    checked by `lambent_capture.checks.check`.
    """
    problems = Problems()
    broken = {path: _known_as_broken(path) for path in left_out}
    manifest = collect_scene(folder, layout, problems, masks, broken, cameras)
    if manifest is not None and photographs.lacks_cameras(manifest.frames):
        problems.error(
            "scene.cameras_missing",
            f"these are {len(manifest.frames)} photographs without cameras; lambent train finds them, and "
            "lambent poses writes a capture that has them",
        )
    if manifest is None or not problems.usable:
        raise SceneRefusedError.of(problems.findings(), layout or "")
    fit_to_masks(folder, manifest)
    return manifest


def _known_as_broken(path: str) -> scene_pb2.Finding:
    return scene_pb2.Finding(
        code="scene.image_broken",
        message=f"{path} could not be decoded; export or copy it again",
        subject=path,
    )


def fit_to_masks(folder: Path, manifest: scene_pb2.SceneManifest) -> None:
    """Put the box around what the masks of the capture in `folder` show, where they show something.

    Raises `SceneRefusedError` where one cannot be read.
    """
    problems = Problems()
    fit_to_silhouettes(manifest, training_silhouettes(folder, manifest, problems))
    if not problems.usable:
        raise SceneRefusedError.of(problems.findings(), manifest.layout)
