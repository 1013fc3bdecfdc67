"""The judgement whether a row of the corpus is read right."""

import traceback
from pathlib import Path

import numpy as np
from lambent_capture.layouts.detect import collect_scene
from lambent_capture.pictures.coverage import frame_coverage
from lambent_capture.problems import Problems
from lambent_proto.v1 import scene_pb2
from strangers import reading
from strangers.captures import Written
from strangers.rows import Row

LIGHT_MARGIN = 0.01
"""Of each channel's mean: 8 bits, and what lossy formats lose of a flat colour."""
ALPHA_MARGIN = 0.01


def fault_of(row: Row, folder: Path) -> str:
    """Return what is wrong with the reading of a row written to a folder, or ""."""
    folder.mkdir()
    row.make(folder)
    files = tuple(path.name for path in folder.rglob("*"))
    try:
        findings, usable, _ = reading.look(folder)
        said = " | ".join(f"{finding.code}: {finding.message}" for finding in findings)
        if row.refused:
            return _refusal_fault(row, findings, said, files, usable=usable)
        fault = _reading_fault(row, folder, said) if usable else f"refused: {said}"
    except Exception:
        return traceback.format_exc(limit=-5)
    codes = {finding.code for finding in findings}
    if fault and any(words in said for words in row.or_said):
        if usable:
            return ""
        fault = reading.unclear(findings, files)
        return f"{fault}: {said}" if fault else ""
    if fault:
        return fault
    lacking = [code for code in row.needs if code not in codes] + [w for w in row.says if w not in said]
    too_much = [code for code in row.lacks if code in codes]
    return f"lacks {lacking}, has {too_much}: {said}" if lacking or too_much else ""


def _refusal_fault(
    row: Row, findings: list[scene_pb2.Finding], said: str, files: tuple[str, ...], *, usable: bool
) -> str:
    if usable:
        return f"was read, and must be refused: {said}"
    errors = " | ".join(f.message for f in findings if f.severity == scene_pb2.SEVERITY_ERROR)
    missing = [words for words in row.refused if words not in errors]
    return f"does not say {missing}: {said}" if missing else reading.unclear(findings, files)


def _reading_fault(row: Row, folder: Path, said: str) -> str:
    manifest = collect_scene(folder, None, Problems())
    if manifest is None:
        return f"has no description: {said}"
    if len(manifest.frames) != row.count:
        return f"{len(manifest.frames)} photographs, not {row.count}: {said}"
    frame = min(manifest.frames, key=lambda each: each.images[0].path)
    if frame.HasField("camera") != row.has_cameras:
        return f"cameras: {frame.HasField('camera')}, not {row.has_cameras}: {said}"
    if not row.has_cameras:
        coverage = frame_coverage(folder, frame)
        alpha = 1.0 if coverage is None else float(coverage.mean())
        return _alpha_fault(alpha, row, said)
    camera = frame.camera
    focal, centre = (camera.focal_x, camera.focal_y), (camera.centre_x, camera.centre_y)
    if not np.allclose(focal, row.focal, atol=0.01) or not np.allclose(centre, row.centre, atol=0.01):
        return f"focal {focal}, not {row.focal}; centre {centre}, not {row.centre}"
    views, _ = reading.trained(Written(folder=folder, readings={}))
    view = views[frame.images[0].path]
    if row.light is not None:
        middle = view[..., 3] > 0.5
        # Over the inner part of the ball, for the whole frame where nothing says what is the object.
        rows, columns = np.mgrid[: view.shape[0], : view.shape[1]]
        inside = np.hypot(rows - 31.5, columns - 31.5) <= 19.0
        found = view[middle & inside & (columns < 32)][:, :3].mean(axis=0)
        if not np.allclose(found, row.light, atol=LIGHT_MARGIN):
            return f"light {found.round(4).tolist()}, not {list(row.light)}: {said}"
    if row.edge is not None:
        half = np.abs(view[..., 3] - 0.5) < 0.05
        found = view[half][:, :3].mean(axis=0)
        if not np.allclose(found, row.edge, atol=LIGHT_MARGIN):
            return f"light of the outline {found.round(4).tolist()}, not {list(row.edge)}: {said}"
    return _alpha_fault(float(view[..., 3].mean()), row, said)


def _alpha_fault(alpha: float, row: Row, said: str) -> str:
    wanted = 1.0 if row.alpha is None else row.alpha
    return "" if abs(alpha - wanted) <= ALPHA_MARGIN else f"alpha {alpha:.4f}, not {wanted:.4f}: {said}"
