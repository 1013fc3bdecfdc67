"""Scores predictions on disk against a scene's truth, by docs/reference/protocol.md."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from flashcache.data.scene import Scene, View
from flashcache.evaluation import metrics
from jaxtyping import Float
from lambent_proto.v1 import evaluation_pb2
from numpy import ndarray

from lambent_worker.report.predictions import (
    CACHE_FOLDER,
    DIRECT_FOLDER,
    UNSCALED_FOLDER,
    encoded,
    read_noise,
)
from lambent_worker.report.request import evenly_spaced

RATIO_VIEWS = 20
INTERIOR_ALPHA = 0.99
UNITS = {"psnr": "dB", "psnr_gamma": "dB", "psnr_linear": "dB", "mae_all": "deg", "mae_mask": "deg"}


@dataclass(slots=True)
class Table:
    """Values of named metrics, view by view."""

    values: dict[str, list[float]] = field(default_factory=dict)
    pooled: dict[str, list[float]] = field(default_factory=dict)
    """Mean squared errors per view of metrics that pool the pixels of all views before the logarithm."""
    counts: dict[str, list[int]] = field(default_factory=dict)
    """Pixels behind each entry of `pooled`."""

    def add(self, name: str, value: float) -> None:
        """Note the value of one view."""
        self.values.setdefault(name, []).append(value)

    def pool(self, name: str, error: float, count: int) -> None:
        """Note the mean squared error of one view over `count` pixels."""
        self.pooled.setdefault(name, []).append(error)
        self.counts.setdefault(name, []).append(count)

    def as_metrics(self) -> list[evaluation_pb2.Metric]:
        """Return means over the views with their standard errors, in the order they were first noted."""
        rows = []
        for name, values in self.values.items():
            rows.append(_metric(name, float(np.mean(values)), metrics.standard_error(np.array(values))))
        for name, errors in self.pooled.items():
            mean = float(np.average(errors, weights=self.counts[name]))
            error = metrics.psnr_standard_error(np.array(errors))
            rows.append(_metric(name, metrics.psnr_from_error(mean), error))
        return rows


def _metric(name: str, value: float, error: float) -> evaluation_pb2.Metric:
    unit = UNITS.get(name.rsplit("/", maxsplit=1)[-1], "1")
    return evaluation_pb2.Metric(name=name, value=value, unit=unit, standard_error=error)


def load(out: Path, folder: str, view: View, name: str) -> Float[ndarray, "height width channels"] | None:
    """Return a predicted map as float64, or None where it was not rendered."""
    path = out / folder / view.name / f"{name}.npy"
    return np.load(path, allow_pickle=False).astype(np.float64) if path.is_file() else None


def albedo_ratios(out: Path, views: Sequence[View]) -> tuple[Float[ndarray, "3"], Float[ndarray, "3"]] | None:
    """Return the factors from predicted to true albedo per channel: median, and least squares.

    Taken over the masked pixels of at most 20 evenly spaced views, both albedos over white; None without
    truth.
    """
    pairs = []
    for view in evenly_spaced(tuple(views), RATIO_VIEWS):
        predicted = load(out, "pred", view, "albedo")
        if predicted is not None and "albedo" in view.truth:
            truth = view.truth["albedo"].astype(np.float64)
            mask = truth[..., 3] > 0.0
            pairs.append((metrics.over_white(truth)[mask], metrics.over_white(predicted)[mask]))
    if not pairs or not sum(len(truth) for truth, _ in pairs):
        return None
    truth, predicted = (np.concatenate(parts) for parts in zip(*pairs, strict=True))
    return (
        metrics.median_albedo_ratio(truth, predicted),
        metrics.least_squares_albedo_ratio(truth, predicted),
    )


def score(out: Path, scene: Scene, views: Sequence[View], *, held_out: bool) -> Table:
    """Return every figure that the predictions below `out` and the truth of `views` allow."""
    table = Table()
    ratios = albedo_ratios(out, views)
    for view in views:
        _score_pictures(table, out, scene, view, "nvs" if held_out else "training_views")
        if ratios is not None:
            _score_albedo(table, out, view, *ratios)
        _score_normals(table, out, view)
        _score_scalars(table, out, view)
    return table


def _score_pictures(table: Table, out: Path, scene: Scene, view: View, seen: str) -> None:
    noise = read_noise(out, view.name)
    groups = [
        (seen, "pred", scene.lights[:1], "physical"),
        (f"{seen}_all_train_lights", "pred", scene.lights[1:] and scene.lights, "physical"),
        (f"{seen}_cache", CACHE_FOLDER, scene.lights, ""),
        ("relight", "pred", scene.relight_lights, "relit"),
        ("relight_direct", DIRECT_FOLDER, scene.relight_lights, "direct"),
        ("relight_unscaled", UNSCALED_FOLDER, scene.relight_lights, "unscaled"),
    ]
    for group, folder, lights, kind in groups:
        found = list(_compared(out, folder, view, lights))
        # One value per view: the mean over its lights, so that views stay independent samples.
        if found:
            table.add(f"{group}/psnr", float(np.mean([psnr for _, psnr, _ in found])))
            table.add(f"{group}/ssim", float(np.mean([ssim for _, _, ssim in found])))
        if group.endswith("_all_train_lights"):
            found = found[1:]  # the first light has its rows already
        for light, psnr, ssim in found:
            name = f"rgb/{light}" if folder == "pred" else f"{group}/{light}"
            table.add(f"{name}/psnr", psnr)
            table.add(f"{name}/ssim", ssim)
            if f"{kind}/{light}" in noise:
                table.add(f"{group}/{light}/monte_carlo_standard_error", noise[f"{kind}/{light}"])


def _compared(
    out: Path, folder: str, view: View, lights: Sequence[str]
) -> Iterator[tuple[str, float, float]]:
    """Yield light, PSNR (dB) and SSIM of the pictures that were rendered and have a truth."""
    for light in lights:
        predicted = load(out, folder, view, f"rgba_{light}")
        if predicted is None or light not in view.images:
            continue
        image = view.images[light]
        truth = metrics.over_white(encoded(image[..., :3], image[..., 3:]).astype(np.float64))
        over = np.clip(metrics.over_white(predicted), 0.0, 1.0)
        yield light, metrics.psnr(over, truth), metrics.ssim(over, truth)


def _score_albedo(
    table: Table, out: Path, view: View, median: Float[ndarray, "3"], fitted: Float[ndarray, "3"]
) -> None:
    predicted = load(out, "pred", view, "albedo")
    if predicted is None or "albedo" not in view.truth:
        return
    given = view.truth["albedo"].astype(np.float64)
    mask, inside = given[..., 3] > 0.0, given[..., 3] > INTERIOR_ALPHA
    truth = metrics.over_white(given)
    everywhere = np.ones_like(mask)
    rows = [
        ("albedo_rgb_ratio", median, everywhere),
        ("albedo_one_ratio", np.repeat(median[:1], 3), everywhere),
        ("albedo_least_squares", fitted, everywhere),
        ("albedo_interior", median, inside),
    ]
    for name, ratio, pixels in rows:
        scaled = metrics.scaled_albedo(predicted, ratio, mask)
        if name != "albedo_interior":
            table.add(f"{name}/ssim", metrics.ssim(scaled, truth))
        a, b = scaled[pixels], truth[pixels]
        if len(a):
            after = metrics.mean_squared_error(metrics.with_albedo_gamma(a), metrics.with_albedo_gamma(b))
            table.pool(f"{name}/psnr_gamma", after, len(a))
            table.pool(f"{name}/psnr_linear", metrics.mean_squared_error(a, b), len(a))


def _score_normals(table: Table, out: Path, view: View) -> None:
    predicted = load(out, "pred", view, "normal")
    if predicted is None or "normal" not in view.truth:
        return
    truth = view.truth["normal"].astype(np.float64)
    mask = _mask(view)
    true_normal = metrics.normal_with_background(truth[..., :3], truth[..., 3:])
    error = metrics.angular_error(_unit(predicted), true_normal)
    table.add("normal/mae_all", float(np.where(mask, error, 0.0).mean()))
    if mask.any():
        table.add("normal/mae_mask", float(error[mask].mean()))


def _score_scalars(table: Table, out: Path, view: View) -> None:
    mask = _mask(view)
    if not mask.any():
        return
    for name in ("roughness", "metallic"):
        predicted = load(out, "pred", view, name)
        if predicted is not None and name in view.truth:
            truth = view.truth[name].astype(np.float64)
            table.add(f"{name}/rmse", metrics.root_mean_square(predicted[mask], truth[mask]))
    predicted = load(out, "pred", view, "distance")
    if predicted is not None and "distance" in view.truth:
        truth = view.truth["distance"].astype(np.float64)
        inside = (truth[..., 0] > 0.0) & mask
        if inside.any():
            table.add("distance/mean_abs", float(np.abs(predicted - truth)[inside].mean()))


def _mask(view: View) -> ndarray:
    """Return where the object is: alpha above 0 in the first map that has one."""
    for kind in ("albedo", "normal"):
        if kind in view.truth:
            return view.truth[kind][..., 3] > 0.0
    return next(iter(view.images.values()))[..., 3] > 0.0


def _unit(normal: Float[ndarray, "height width 3"]) -> Float[ndarray, "height width 3"]:
    return normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-9)
