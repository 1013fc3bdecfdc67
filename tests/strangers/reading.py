"""The product's reading of a capture, seen from every place that reads its pictures."""

import re
import traceback
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import numpy as np
from lambent_capture.checks.limits import CaptureLimits
from lambent_capture.checks.observe import observe
from lambent_capture.checks.photograph_check import check_photographs
from lambent_capture.checks.review import review
from lambent_capture.layouts.detect import describe_scene, detect_layout
from lambent_capture.loading.inspect import inspect_files
from lambent_capture.loading.load import full_size_views, load_scene
from lambent_capture.masks.photograph import photographs_of
from lambent_capture.pictures.coverage import frame_coverage
from lambent_capture.poses.features import grey_picture
from lambent_capture.poses.photographs import covered_pixels, find_photographs
from lambent_capture.problems import Problems
from lambent_core.errors import SceneRefusedError, WorkerError
from lambent_proto.v1 import scene_pb2
from numpy import ndarray
from strangers.captures import Written
from strangers.colours import LUMINANCE, encoded
from strangers.pictures import Reading

ROOT = Path(__file__).parents[2]
VAGUE = frozenset({"scene.refused", "scene.check_failed", "scene.layout_unknown"})
"""Codes that do not say what is wrong with a picture."""
_REC601 = np.array([0.299, 0.587, 0.114])
FURTHER = frozenset({"scene.too_few_images", "scene.mirrored"})
"""Codes that may accompany that of the cause: what follows from it, and what is true as well."""
RIGHT, REFUSED, SILENT, TRACEBACK, UNCLEAR = "right", "refused", "silent", "traceback", "unclear"


@dataclass(kw_only=True, slots=True)
class Outcome:
    """What became of a capture."""

    kind: str
    why: str = ""
    codes: tuple[str, ...] = ()
    """Of all findings."""
    views: dict[str, ndarray] = field(default_factory=dict)
    """Linear red, green, blue, alpha of each photograph, as training sees it."""
    manifest: scene_pb2.SceneManifest | None = None


class DifferenceError(Exception):
    """A place reads something else than it should."""


@cache
def documented() -> frozenset[str]:
    """Return the codes of findings that the reference describes."""
    text = (ROOT / "docs" / "reference" / "findings-codes.md").read_text(encoding="utf-8")
    return frozenset(re.findall(r"`([a-z_]+\.[a-z_]+)`", text))


def outcome_of(written: Written) -> Outcome:
    """Return what became of a capture whose pictures are known."""
    try:
        return _outcome(written)
    except DifferenceError as difference:
        return Outcome(kind=SILENT, why=str(difference))
    except Exception:
        return Outcome(kind=TRACEBACK, why=traceback.format_exc(limit=-6))


def _outcome(written: Written) -> Outcome:
    findings, usable, left_out = look(written.folder, written.masks)
    codes = tuple(sorted({finding.code for finding in findings}))
    if not usable:
        why = unclear(findings, written.files)
        said = next(f"{f.code}: {f.message}" for f in findings if f.severity == scene_pb2.SEVERITY_ERROR)
        return Outcome(kind=UNCLEAR if why else REFUSED, why=f"{why}: {said}" if why else said, codes=codes)
    if left_out:
        raise DifferenceError(f"{left_out} left out though all photographs are alike")
    try:
        views, manifest = trained(written)
    except (SceneRefusedError, WorkerError) as error:
        raise DifferenceError(f"the check has no error, training has: {error}") from error
    if not all(written.readings.values()):
        raise DifferenceError("was read although its levels are not light in linear units")
    wrong = [
        f"{path}: {why}" for path, each in written.readings.items() if (why := differs(views.get(path), each))
    ]
    if wrong:
        raise DifferenceError("; ".join(wrong[:2]) + f" (findings: {', '.join(codes)})")
    compare_places(written, manifest, views)
    return Outcome(kind=RIGHT, codes=codes, views=views, manifest=manifest)


def look(folder: Path, masks: Path | None = None) -> tuple[list[scene_pb2.Finding], bool, tuple[str, ...]]:
    """Return the findings of `lambent check`, whether the capture can be used, and what is left out."""
    if detect_layout(folder) == "photographs":
        looked = check_photographs(folder, masks)
        return list(looked.report.findings), looked.report.usable, tuple(looked.left_out)
    found = inspect_files(folder, None, {}, lambda path: None, masks, None)
    if found.manifest is not None and found.report.usable:
        review(folder, found.manifest, found.report, CaptureLimits())
    return list(found.report.findings), found.report.usable, found.left_out


def trained(written: Written) -> tuple[dict[str, ndarray], scene_pb2.SceneManifest]:
    """Return what training sees of each photograph, and the description that it goes by."""
    manifest = describe_scene(written.folder, masks=written.masks, cameras=written.cameras)
    scene = load_scene(written.folder, manifest, max_side=4096, crop="frame")
    paths = {frame.name: frame.images[0].path for frame in manifest.frames}
    views = {paths[view.name]: next(iter(view.images.values())) for view in (*scene.train, *scene.test)}
    return views, manifest


def unclear(findings: list[scene_pb2.Finding], files: tuple[str, ...]) -> str:
    """Return why a refusal is not clear: one error that names file, cause and remedy; "" where it is."""
    errors = [finding for finding in findings if finding.severity == scene_pb2.SEVERITY_ERROR]
    codes = {finding.code for finding in errors}
    if len(codes) > 1:
        codes -= FURTHER
    errors = [finding for finding in errors if finding.code in codes]
    if len(codes) != 1:
        return f"{len(codes)} kinds of error"
    code = next(iter(codes))
    if code in VAGUE or code not in documented():
        return "a code that names no cause" if code in VAGUE else "a code that is not documented"
    subjects = [finding.subject for finding in errors]
    if len(set(subjects)) < len(subjects):
        return "one file is named twice"
    stems = {name.split(".")[0] for name in files}
    for finding in errors:
        if not any(stem in finding.message + finding.subject for stem in stems):
            return "names no file"
        if ";" not in finding.message and " so " not in finding.message:
            return "names no remedy"
        if "Traceback" in finding.message or "Error(" in finding.message:
            return "shows the inside of the program"
    return ""


def differs(found: ndarray | None, right: list[Reading]) -> str:
    """Return how light with alpha differs from the nearest of its right readings; "" where not."""
    if found is None:
        return "is not among the views"
    whys = [why for each in right if not (why := _differs(found, each)) or why]
    return "" if "" in whys else min(whys, key=len) if whys else "has no right reading"


def _differs(found: ndarray, right: Reading) -> str:
    if found.shape[:2] != right.alpha.shape:
        return f"has {found.shape[1]} x {found.shape[0]} pixels, not {right.alpha.shape[::-1]}"
    off = np.abs(found[..., 3] - right.alpha)
    if (off > right.alpha_margin).any():
        return f"mean alpha {found[..., 3].mean():.4f}, not {right.alpha.mean():.4f}, off by {off.max():.3f}"
    seen = right.alpha > 0.2
    light = found[..., :3]
    # Colours outside Rec. 709 may be clipped on either side.
    candidates = (right.light, np.maximum(right.light, 0.0), np.clip(right.light, 0.0, 1.0))
    error = np.min([np.abs(light - each) for each in candidates], axis=0) - right.margin
    error = np.where(seen[..., None], error, 0.0)
    if not np.isfinite(light[seen]).all() or error.max() > 0.0:
        row, column, channel = np.unravel_index(np.argmax(error), error.shape)
        means = " ".join(f"{value:.3f}" for value in light[seen].mean(axis=0))
        wanted = " ".join(f"{value:.3f}" for value in right.light[seen].mean(axis=0))
        at = row, column, channel
        return (
            f"mean light {means}, not {wanted}; at {column},{row} {'rgb'[channel]} {light[at]:.4f}, "
            f"not {right.light[at]:.4f} +- {right.margin[at]:.4f}"
        )
    return ""


def compare_places(written: Written, manifest: scene_pb2.SceneManifest, views: dict[str, ndarray]) -> None:
    """Raise `DifferenceError` where another place that reads pictures sees something else than training."""
    folder = written.folder
    for each in observe(folder, manifest, CaptureLimits()):
        _same("check: alpha", each.coverage, views[each.pictures[0].path][..., 3], 0.02)
        view = views[each.pictures[0].path]
        light = view[..., :3] @ LUMINANCE.astype(np.float32)
        shown = np.where(view[..., 3] > 0.98, each.pictures[0].luminance, light)
        _same("check: luminance", np.minimum(shown, 1.0), np.minimum(light, 1.0), 0.03, relative=0.03)
    names = {frame.name: frame for frame in manifest.frames}
    for photograph in photographs_of(folder, manifest):
        view = views[names[photograph.name].images[0].path]
        inside = view[..., 3:] > 0.98
        shown = encoded("srgb", np.clip(view[..., :3], 0.0, 1.0))
        _same("masks: colours", np.where(inside, photograph.read(4096) / 255.0, shown), shown, 0.03)
    for frame in manifest.frames:
        path = frame.images[0].path
        view = views[path]
        coverage = frame_coverage(folder, frame)
        alpha = np.ones(view.shape[:2]) if coverage is None else coverage
        _same("silhouettes: alpha", alpha, view[..., 3], 0.01)
        grey, _ = grey_picture(folder / path, (0, 0, view.shape[1], view.shape[0]), 4096)
        inside = view[..., 3] > 0.98
        if _likeness(grey[inside], view[inside][:, :3], frame.images[0].encoding) < 0.6:
            raise DifferenceError("cameras: the grey picture is another one than training's")
    for view in full_size_views(folder, manifest, manifest.lights[0]):
        whole = views[names[view.name].images[0].path]
        image = next(iter(view.images.values()))
        rows = slice(view.margins.top, view.margins.top + image.shape[0])
        columns = slice(view.margins.left, view.margins.left + image.shape[1])
        part = whole[rows, columns]
        if part.shape != image.shape:
            raise DifferenceError("textures: the crop lies outside of the frame")
        _same("textures: alpha", image[..., 3], part[..., 3], 0.01)
        _same("textures: light", image[..., :3] * image[..., 3:], part[..., :3] * part[..., 3:], 0.01)
        if whole[..., 3].sum() - part[..., 3].sum() > 0.1 * 4:
            raise DifferenceError("textures: the crop cuts the object")
    if written.cameras is not None:
        _same_for_cameras(written, views)


def _likeness(grey: ndarray, light: ndarray, encoding: str) -> float:
    """Return the correlation of a grey picture with what training sees; 1 where both are flat.

    Grey comes of levels in any profile, or of light in parts of its brightest.
    """
    if encoding == "srgb":
        luma = encoded("srgb", np.clip(light, 0.0, 1.0)) @ _REC601
    else:
        luma = np.clip(light / max(float(np.percentile(light, 99.5)), 1e-9), 0.0, 1.0) ** (1 / 2.2) @ _REC601
    if min(luma.std(), grey.std() / 255) < 0.03:
        return 1.0
    return float(np.corrcoef(grey, luma)[0, 1])


def _same_for_cameras(written: Written, views: dict[str, ndarray]) -> None:
    problems = Problems()
    photographs = find_photographs(written.folder, None, problems)
    if photographs is None:
        raise DifferenceError(f"cameras: {problems.findings()[0].message}")
    masked = any((view[..., 3] < 0.5).any() for view in views.values())
    if photographs.masked != masked:
        raise DifferenceError(f"cameras: masked is {photographs.masked}, training says {masked}")
    for name in photographs.names if masked else ():
        inside = covered_pixels(photographs, name)
        alpha = views[f"images/{name}"][..., 3]
        # A mask's and a photograph's own alpha are both there in training; cameras take the mask.
        if (inside.shape != alpha.shape) or ((alpha > 0.55) & ~inside).any():
            raise DifferenceError("cameras: other pixels are covered than in training")


def _same(place: str, found: ndarray, wanted: ndarray, margin: float, relative: float = 0.0) -> None:
    if found.shape != wanted.shape:
        raise DifferenceError(f"{place}: size {found.shape} where training has {wanted.shape}")
    off = np.abs(found - wanted) - relative * np.abs(wanted)
    if not (off <= margin).all():
        at = np.unravel_index(np.argmax(off), off.shape)
        raise DifferenceError(f"{place}: {found[at]:.3f} where training has {wanted[at]:.3f}")
