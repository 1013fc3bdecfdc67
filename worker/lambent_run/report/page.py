"""Builds report.html: one file with pictures, tables and the protocol they follow."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from flashcache.evaluation import metrics
from jaxtyping import Float
from jinja2 import Environment, PackageLoader, StrictUndefined
from lambent_core.measured import measured
from lambent_core.scene import Scene, View, evenly_spaced
from lambent_proto.v1 import evaluation_pb2
from lambent_relight.bundle.uncertainty import CHANNELS
from numpy import ndarray

from lambent_run.report import figures
from lambent_run.report.environment_scores import FOLDER, LUMINANCE, compare_environments
from lambent_run.report.predictions import CACHE_FOLDER, DIRECT_FOLDER, ERROR_SUFFIX, load, over_white
from lambent_run.report.published import METRICS

MAX_VIEWS = 6
"""Views shown as pictures; the tables cover all."""

SINGLE_LIGHTS = "Single lights"
# Rows of the page's tables, by the start of a metric's name; the first match decides.
GROUPS = (
    ("Novel views", ("nvs", "training_views")),
    ("Relighting", ("relight",)),
    ("Albedo", ("albedo",)),
    ("Shape", ("normal", "distance")),
    ("Materials", ("roughness", "metallic")),
    ("Recovered light", ("environment",)),
    ("Uncertainty of materials", ("uncertainty",)),
    (SINGLE_LIGHTS, ("rgb",)),
)

Picture = Float[ndarray, "height width 3"]


def write_page(
    path: Path,
    report: evaluation_pb2.EvaluationReport,
    out: Path,
    scene: Scene,
    views: Sequence[View],
    ratio: Float[ndarray, "3"] | None,
) -> None:
    """Write the report as a self-contained page, from predictions below `out`."""
    environment = Environment(
        loader=PackageLoader("lambent_run.report", "."), autoescape=True, undefined=StrictUndefined
    )
    shown = evenly_spaced(tuple(views), MAX_VIEWS)
    rows = [(view.name, view_figures(out, scene, view, ratio)) for view in shown]
    environment.filters["measured"] = measured
    page = environment.get_template("page.html.j2").render(
        report=report,
        groups=grouped(report.metrics),
        single_lights=SINGLE_LIGHTS,
        comparison=comparison(report),
        rows=rows,
        environments=environment_figures(out, scene.lights),
        error_scale=figures.ERROR_SCALE,
        noise_scale=figures.NOISE_SCALE,
        relative_scale=figures.RELATIVE_SCALE,
        material_scale=figures.MATERIAL_SCALE,
    )
    path.write_text(page, encoding="utf-8")


@dataclass(frozen=True, slots=True)
class Comparison:
    """Our metrics next to published ones: a table with one column per figure."""

    columns: tuple[str, ...]
    rows: tuple[tuple[str, tuple[float | None, ...]], ...]


def comparison(report: evaluation_pb2.EvaluationReport) -> Comparison | None:
    """Return the published results for this scene with ours as the last line, or None if there are none."""
    if not report.published:
        return None
    known = {name for result in report.published for name in result.values}
    columns = tuple(name for name in METRICS.values() if name in known)
    ours = {row.name: row.value for row in report.metrics}
    lines = [(result.method, dict(result.values)) for result in report.published]
    lines.append((f"this run ({report.preset})", ours))
    rows = tuple((title, tuple(values.get(name) for name in columns)) for title, values in lines)
    return Comparison(columns, rows)


def grouped(
    rows: Sequence[evaluation_pb2.Metric],
) -> list[tuple[str, list[evaluation_pb2.Metric]]]:
    """Return the metrics under the headings of the page, empty headings left out; single lights come last."""
    members: dict[str, list[evaluation_pb2.Metric]] = {title: [] for title, _ in GROUPS}
    for row in rows:
        single = row.name.count("/") > 1
        title = next(
            title for title, starts in GROUPS if row.name.startswith(starts) or title == SINGLE_LIGHTS
        )
        members[SINGLE_LIGHTS if single else title].append(row)
    return [(title, listed) for title, listed in members.items() if listed]


def view_figures(
    out: Path, scene: Scene, view: View, ratio: Float[ndarray, "3"] | None
) -> list[list[tuple[str, str]]]:
    """Return title and data URI of the pictures of one view, in the lines in which they are shown."""
    lines = [_light_line(out, view, light) for light in scene.lights]
    lines.append(_surface_line(out, view, ratio))
    lines.append(_uncertainty_line(out, view))
    lines += [_relit_line(out, view, light) for light in scene.relight_lights]
    return [[(title, figures.data_uri(values)) for title, values in line] for line in lines if line]


def environment_figures(out: Path, lights: Sequence[str]) -> list[tuple[str, str]]:
    """Return title and data URI of the environments that were compared, each beside the true one.

    Twice the true map's mean is white.
    """
    shown = []
    for light in lights:
        paths = [out / FOLDER / f"{name}.npy" for name in (light, f"{light}_true")]
        if not all(path.is_file() for path in paths):
            continue
        recovered, truth = (np.load(path, allow_pickle=False).astype(np.float64) for path in paths)
        white = max(2.0 * float((truth @ LUMINANCE).mean()), 1e-8)
        scaled = recovered * compare_environments(recovered, truth).factor
        for title, image in ((f"true light, {light}", truth), (f"recovered, {light}", scaled)):
            opaque = np.concatenate([image / white, np.ones_like(image[..., :1])], axis=-1)
            shown.append((title, figures.data_uri(over_white(opaque))))
    return shown


def _photograph(view: View, light: str) -> Picture | None:
    return over_white(view.images[light]) if light in view.images else None


def _light_line(out: Path, view: View, light: str) -> list[tuple[str, Picture]]:
    truth = _photograph(view, light)
    line = [] if truth is None else [(f"photograph, {light}", truth)]
    for title, folder in (("physically based", "pred"), ("cache", CACHE_FOLDER)):
        line += _with_error(title, load(out, folder, view, f"rgba_{light}"), truth)
        line += _noise(title, out, folder, view, light)
    return line


def _noise(title: str, out: Path, folder: str, view: View, light: str) -> list[tuple[str, Picture]]:
    """Return the standard error of a Monte Carlo picture in encoded values, as heat."""
    error = load(out, folder, view, f"rgba_{light}{ERROR_SUFFIX}")
    predicted = load(out, folder, view, f"rgba_{light}")
    if error is None or predicted is None:
        return []
    encoded_error = metrics.encoded_standard_error(predicted, error).mean(axis=-1)
    return [(f"noise, {title}", figures.heat(encoded_error / figures.NOISE_SCALE))]


def _relit_line(out: Path, view: View, light: str) -> list[tuple[str, Picture]]:
    predicted = load(out, "pred", view, f"rgba_{light}")
    if predicted is None:
        return []
    truth = _photograph(view, light)
    line = [] if truth is None else [(f"truth, {light}", truth)]
    line += _with_error(f"relit, {light}", predicted, truth)
    line += _noise(f"relit, {light}", out, "pred", view, light)
    line += _with_error("relit, direct light only", load(out, DIRECT_FOLDER, view, f"rgba_{light}"), truth)
    return line


def _with_error(
    title: str, predicted: Float[ndarray, "height width 4"] | None, truth: Picture | None
) -> list[tuple[str, Picture]]:
    if predicted is None:
        return []
    shown = figures.picture(predicted)
    if truth is None:
        return [(title, shown)]
    return [(title, shown), (f"error, {title}", figures.error_map(shown, truth))]


def _uncertainty_line(out: Path, view: View) -> list[tuple[str, Picture]]:
    """Return the uncertainty of the materials as heat, white in the background."""
    values = load(out, "pred", view, "uncertainty")
    albedo = load(out, "pred", view, "albedo")
    if values is None or albedo is None:
        return []
    alpha = albedo[..., 3:]
    scales = {
        "albedo": figures.RELATIVE_SCALE,
        "albedo_from_light": figures.RELATIVE_SCALE,
        "metalness": figures.MATERIAL_SCALE,
        "perceptual_roughness": figures.MATERIAL_SCALE,
        "views": max(1.0, float(values[..., CHANNELS.index("views")].max())),
    }
    titles = {"albedo_from_light": "of it, owed to the light", "views": "photographs that see it"}
    return [
        (
            titles.get(name, f"uncertainty of {name.replace('_', ' ')}"),
            figures.heat(values[..., number] / scales[name]) * alpha + (1.0 - alpha),
        )
        for number, name in enumerate(CHANNELS)
    ]


def _surface_line(out: Path, view: View, ratio: Float[ndarray, "3"] | None) -> list[tuple[str, Picture]]:
    albedo, normal = load(out, "pred", view, "albedo"), load(out, "pred", view, "normal")
    roughness, metalness = load(out, "pred", view, "roughness"), load(out, "pred", view, "metallic")
    if albedo is None or normal is None or roughness is None or metalness is None:
        return []
    alpha = albedo[..., 3:]
    factor = np.ones(3) if ratio is None else ratio
    scaled = figures.albedo_map(albedo[..., :3] * factor) * alpha + (1.0 - alpha)
    line = [("albedo" if ratio is None else "albedo, scaled", scaled)]
    if "albedo" in view.truth:
        truth = metrics.over_white(view.truth["albedo"].astype(np.float64))
        line.append(("true albedo", figures.albedo_map(truth)))
    line.append(("normal", figures.normal_map(normal, alpha)))
    if "normal" in view.truth:
        truth = view.truth["normal"].astype(np.float64)
        line.append(("true normal", figures.normal_map(truth[..., :3], truth[..., 3:])))
    for title, kind, values in (("roughness", "roughness", roughness), ("metalness", "metallic", metalness)):
        line.append((title, figures.grey_map(values, alpha)))
        if kind in view.truth:
            coverage = view.truth["albedo"][..., 3:] if "albedo" in view.truth else alpha
            line.append((f"true {title}", figures.grey_map(view.truth[kind].astype(np.float64), coverage)))
    return line
