"""Scores predictions on disk against a scene's truth, by docs/reference/protocol.md."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from flashcache.evaluation import metrics
from flashcache.evaluation.lpips import Lpips
from jaxtyping import Bool, Float
from lambent_core.scene import Scene, View, evenly_spaced
from lambent_relight.bundle.uncertainty import CHANNELS
from numpy import ndarray

from lambent_run.report.predictions import (
    CACHE_FOLDER,
    DIRECT_FOLDER,
    ERROR_SUFFIX,
    UNSCALED_FOLDER,
    encoded,
    load,
    read_noise,
)
from lambent_run.report.published import dataset_of
from lambent_run.report.table import Table

RATIO_VIEWS = 20
INTERIOR_ALPHA = 0.99
FEWEST_PIXELS = 50
"""With a predicted uncertainty, below which nothing is said of it."""
DARKEST = 1e-3
"""Albedo below this is compared as this: a relative error of nothing means nothing."""


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


@dataclass(frozen=True, kw_only=True, slots=True)
class Ruling:
    """Rules for comparing pictures and naming the metrics."""

    held_out: bool
    """Whether the views were kept from training."""
    lpips: Lpips | None = None
    masked: bool = False
    """Multiply both pictures by the object's mask instead of showing them over white."""
    novel_views: str = "nvs"
    relight: str = "relight"

    @classmethod
    def of(cls, scene: Scene, *, held_out: bool, dataset: str = "", lpips: Lpips | None = None) -> "Ruling":
        """Return the protocol's rule for a data set.

        On OpenIllumination novel views count from a run in one light and relit pictures from a run in
        several; the others get a name that no table looks for.
        """
        several = len(scene.lights) > 1
        open_illumination = dataset_of(dataset) == "openillumination"
        return cls(
            held_out=held_out,
            lpips=lpips,
            masked=open_illumination,
            novel_views="nvs_several_lights" if open_illumination and several else "nvs",
            relight="relight_one_light" if open_illumination and not several else "relight",
        )


def score(out: Path, scene: Scene, views: Sequence[View], ruling: Ruling) -> Table:
    """Return every figure that the predictions below `out` and the truth of `views` allow."""
    table = Table()
    ratios = albedo_ratios(out, views)
    for view in views:
        _score_pictures(table, out, scene, view, ruling)
        if ratios is not None:
            _score_albedo(table, out, view, *ratios, ruling.lpips)
            score_uncertainty(table, out, view, ratios[0])
        _score_normals(table, out, view)
        _score_scalars(table, out, view)
    return table


def object_mask(view: View) -> Bool[ndarray, "height width"]:
    """Return where the object is: alpha above 0 in the first map that has one."""
    for kind in ("albedo", "normal"):
        if kind in view.truth:
            return view.truth[kind][..., 3] > 0.0
    return next(iter(view.images.values()))[..., 3] > 0.0


def _score_pictures(table: Table, out: Path, scene: Scene, view: View, ruling: Ruling) -> None:
    noise = read_noise(out, view.name)
    seen, relit = ruling.novel_views if ruling.held_out else "training_views", ruling.relight
    groups = [
        (seen, "pred", scene.lights[:1], "physical"),
        (f"{seen}_all_train_lights", "pred", scene.lights[1:] and scene.lights, "physical"),
        (f"{seen}_cache", CACHE_FOLDER, scene.lights, ""),
        (relit, "pred", scene.relight_lights, "relit"),
        (f"{relit}_direct", DIRECT_FOLDER, scene.relight_lights, "direct"),
        (f"{relit}_unscaled", UNSCALED_FOLDER, scene.relight_lights, "unscaled"),
    ]
    for group, folder, lights, kind in groups:
        compared = list(_compared(out, folder, view, lights, ruling))
        # One value per view: the mean over its lights, so that views stay independent samples.
        for name in compared[0][1] if compared else ():
            table.add(f"{group}/{name}", float(np.mean([values[name] for _, values in compared])))
        _score_noise(table, out / folder / view.name, group, [light for light, _ in compared])
        if group.endswith("_all_train_lights"):
            compared = compared[1:]  # the first light has its rows already
        for light, values in compared:
            prefix = f"rgb/{light}" if folder == "pred" else f"{group}/{light}"
            for name, value in values.items():
                table.add(f"{prefix}/{name}", value)
            if f"{kind}/{light}" in noise:
                table.add(f"{group}/{light}/monte_carlo_standard_error", noise[f"{kind}/{light}"])


def _compared(
    out: Path, folder: str, view: View, lights: Sequence[str], ruling: Ruling
) -> Iterator[tuple[str, dict[str, float]]]:
    """Yield light and figures of the pictures that were rendered and have a truth."""
    for light in lights:
        predicted = load(out, folder, view, f"rgba_{light}")
        if predicted is None or light not in view.images:
            continue
        image = view.images[light]
        truth = metrics.over_white(encoded(image[..., :3], image[..., 3:]).astype(np.float64))
        over = np.clip(metrics.over_white(predicted), 0.0, 1.0)
        if ruling.masked:
            inside = object_mask(view)[..., None]
            truth, over = truth * inside, over * inside
        figures = {"psnr": metrics.psnr(over, truth), "ssim": metrics.ssim(over, truth)}
        if ruling.lpips is not None:
            figures[f"lpips_{ruling.lpips.name}"] = ruling.lpips.distance(over, truth)
        yield light, figures


def _score_noise(table: Table, folder: Path, group: str, lights: Sequence[str]) -> None:
    """Note the mean squared error in encoded values that is due to Monte Carlo noise alone."""
    errors, count = [], 0
    for light in lights:
        path = folder / f"rgba_{light}{ERROR_SUFFIX}.npy"
        if path.is_file():
            rgba = np.load(folder / f"rgba_{light}.npy", allow_pickle=False)
            error = metrics.encoded_standard_error(rgba, np.load(path, allow_pickle=False))
            errors.append(float(np.mean(np.square(error))))
            count += error.size // 3
    if errors and max(errors) > 0.0:
        table.pool(f"{group}/noise_ceiling", float(np.mean(errors)), count)


def _score_albedo(
    table: Table,
    out: Path,
    view: View,
    median: Float[ndarray, "3"],
    fitted: Float[ndarray, "3"],
    lpips: Lpips | None,
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
            if lpips is not None:
                table.add(f"{name}/lpips_{lpips.name}", lpips.distance(scaled, truth))
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
    mask = object_mask(view)
    true_normal = metrics.normal_with_background(truth[..., :3], truth[..., 3:])
    unit = predicted / np.maximum(np.linalg.norm(predicted, axis=-1, keepdims=True), 1e-9)
    error = metrics.angular_error(unit, true_normal)
    table.add("normal/mae_all", float(np.where(mask, error, 0.0).mean()))
    if mask.any():
        table.add("normal/mae_mask", float(error[mask].mean()))


def _score_scalars(table: Table, out: Path, view: View) -> None:
    mask = object_mask(view)
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


def score_uncertainty(table: Table, out: Path, view: View, ratio: Float[ndarray, "3"]) -> None:
    """Note how predicted and actual relative errors of albedo go together on the object's inner pixels.

    `albedo_rank_correlation` is Spearman's, 1 if pixels with higher predicted uncertainty always have larger
    errors. `albedo_calibration` is the root mean square of actual over predicted error: 1 where the sizes are
    right, larger where the prediction is too sure.
    """
    uncertainty = load(out, "pred", view, "uncertainty")
    predicted = load(out, "pred", view, "albedo")
    if uncertainty is None or predicted is None or "albedo" not in view.truth:
        return
    truth = view.truth["albedo"].astype(np.float64)
    width = uncertainty[..., CHANNELS.index("albedo")]
    inside = (truth[..., 3] > INTERIOR_ALPHA) & (width > 0.0)
    if inside.sum() < FEWEST_PIXELS:
        return
    scaled = np.clip(predicted[..., :3] * ratio, DARKEST, 1.0)
    error = np.abs(np.log(scaled / np.clip(truth[..., :3], DARKEST, 1.0)))[inside]
    width = width[inside]
    if np.ptp(width) > 0.0 and np.ptp(error) > 0.0:
        from scipy.stats import spearmanr  # Takes a second to import.

        correlation = spearmanr(width, error.mean(axis=-1)).statistic
        table.add("uncertainty/albedo_rank_correlation", float(correlation))
    scores = error / width[:, None]
    table.add("uncertainty/albedo_calibration", float(np.sqrt(np.square(scores).mean())))
