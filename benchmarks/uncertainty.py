"""Correlate the predicted uncertainty of albedo with its error, and vary the priors.

    lambent train SCENE --preset fast -o RUN
    lambent evaluate RUN SCENE --repeats 1 -o REPORT
    python -m benchmarks uncertainty RUN SCENE REPORT

Pixels of the test views inside the object (truth alpha above 0.99) are pooled. The error of albedo is the
mean over channels of |log(scaled prediction / truth)|, after the median ratio per channel. `given albedo`
removes what the brightness of the predicted albedo explains of both ranks (a cubic in its rank).
"""

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from lambent_relight.bundle.uncertainty import CHANNELS
from scipy.stats import spearmanr

QUICK = "{run} {sample} {report} --without-variants"

VARIANTS = {
    "as shipped": {},
    "tilt 0.05": {"tilt": 0.05},
    "tilt 0.3": {"tilt": 0.3},
    "light 0.5": {"log_light": 0.5},
    "light 2": {"log_light": 2.0},
    "near field 0.05": {"log_near": 0.05},
    "near field 0.5": {"log_near": 0.5},
    "metalness 0.1": {"metalness": 0.1},
    "50 independent points": {"independent_points": 50.0},
    "800 independent points": {"independent_points": 800.0},
}
DARKEST = 1e-3


def read(path: Path) -> np.ndarray:
    """Return a map as float64: PNG in 0..1, NPY as it is."""
    if path.suffix == ".npy":
        return np.load(path, allow_pickle=False).astype(np.float64)
    from PIL import Image

    return np.asarray(Image.open(path), np.float64) / 255.0


def pixels(scene: Path, report: Path) -> dict[str, np.ndarray]:
    """Return, for every pixel inside the object in any test view, prediction, truth and where it is."""
    ratio = json.loads((report / "report.json").read_text())["albedo_ratio_rgb"]
    found: dict[str, list[np.ndarray]] = {}
    for folder in sorted((report / "pred").iterdir()):
        truth = read(scene / folder.name / "albedo.png")
        uncertainty, albedo = read(folder / "uncertainty.npy"), read(folder / "albedo.npy")
        inside = (truth[..., 3] > 0.99) & (uncertainty[..., 0] > 0.0)
        scaled = np.clip(albedo[..., :3] * ratio, DARKEST, 1.0)[inside]
        wanted = np.clip(truth[..., :3], DARKEST, 1.0)[inside]
        normal = read(folder / "normal.npy")[inside]
        true_normal = read(scene / folder.name / "normal.png")[..., :3][inside] * 2.0 - 1.0
        true_normal /= np.linalg.norm(true_normal, axis=-1, keepdims=True)
        cosine = np.clip((normal * true_normal).sum(axis=-1), -1.0, 1.0)
        values = {
            "uncertainty": uncertainty[inside],
            "error": np.abs(np.log(scaled / wanted)),
            "encoded_error": np.abs(scaled ** (1 / 2.2) - wanted ** (1 / 2.2)).mean(axis=-1),
            "albedo": scaled.mean(axis=-1),
            "normal_error": np.degrees(np.arccos(cosine)),
        }
        for name, value in values.items():
            found.setdefault(name, []).append(value)
    return {name: np.concatenate(parts) for name, parts in found.items()}


def rank_correlation(first: np.ndarray, second: np.ndarray) -> float:
    """Return Spearman's rank correlation."""
    return float(spearmanr(first, second).statistic)


def partial_correlation(first: np.ndarray, second: np.ndarray, given: np.ndarray) -> float:
    """Return the correlation of ranks after a cubic in the rank of `given` was taken out of both."""
    ranks = [np.argsort(np.argsort(values)) / len(values) for values in (first, second, given)]
    basis = np.vander(ranks[2], 4)
    rest = [rank - basis @ np.linalg.lstsq(basis, rank, rcond=None)[0] for rank in ranks[:2]]
    return float(np.corrcoef(*rest)[0, 1])


def print_tables(found: dict[str, np.ndarray]) -> None:
    """Print the correlations and the fifths of the pixels by predicted uncertainty."""
    error = found["error"].mean(axis=-1)
    print(f"{len(error)} pixels\n\n| predictor | rank correlation with the error of albedo | given albedo |")
    print("| --- | --- | --- |")
    predictors = {
        "uncertainty of albedo": found["uncertainty"][:, CHANNELS.index("albedo")],
        "its part owed to the light": found["uncertainty"][:, CHANNELS.index("albedo_from_light")],
        "few photographs": -found["uncertainty"][:, CHANNELS.index("views")],
        "error of the normal (needs truth)": found["normal_error"],
        "dark albedo": -found["albedo"],
    }
    for name, values in predictors.items():
        given = "" if name == "dark albedo" else f"{partial_correlation(values, error, found['albedo']):.2f}"
        print(f"| {name} | {rank_correlation(values, error):.2f} | {given} |")
    width = predictors["uncertainty of albedo"]
    encoded = width * found["albedo"] ** (1 / 2.2) / 2.2
    print(
        f"\nAfter a gamma of 2.2: {rank_correlation(encoded, found['encoded_error']):.2f}. "
        f"Actual over predicted error, root mean square: "
        f"{np.sqrt(np.square(found['error'] / width[:, None]).mean()):.2f}.\n"
    )
    print("| fifth, by uncertainty | predicted | actual | after gamma | albedo | error of the normal |")
    print("| --- | --- | --- | --- | --- | --- |")
    edges = np.quantile(width, np.linspace(0, 1, 6))
    for number in range(5):
        part = (width >= edges[number]) & (width <= edges[number + 1])
        cells = [width, error, found["encoded_error"], found["albedo"], found["normal_error"]]
        shown = " | ".join(f"{values[part].mean():.3f}" for values in cells)
        print(f"| {number + 1} | {shown} |")


def print_variants(run_dir: Path, scene_dir: Path, report: Path) -> None:
    """Print how the map and its use change with the priors."""
    from lambent_run.report.request import rule_of
    from lambent_run.report.uncertainty import PRIORS, measure_uncertainty, uncertainty_map
    from lambent_run.run.prepare import open_task
    from lambent_run.run.tasks.training import load_final, read_scene

    context = open_task(run_dir, "evaluate", None)
    scene = read_scene(context)
    model = load_final(context, scene).eval().requires_grad_(False)
    rule = rule_of(context.spec.config.stage_two)
    ratio = json.loads((report / "report.json").read_text())["albedo_ratio_rgb"]
    first = None
    print("\n| priors | median | rank correlation with the map as shipped | with the error | seconds |")
    print("| --- | --- | --- | --- | --- |")
    for name, changes in VARIANTS.items():
        started = time.process_time()
        grid = measure_uncertainty(
            model, scene, seed=context.spec.seed, rule=rule, priors=replace(PRIORS, **changes)
        )
        seconds = time.process_time() - started
        widths, errors = [], []
        for view in [v for v in scene.test if (report / "pred" / v.name).is_dir()]:
            folder = report / "pred" / view.name
            found = uncertainty_map(model, grid, view.camera, read(folder / "distance.npy"))
            truth = read(scene_dir / view.name / "albedo.png")
            inside = (truth[..., 3] > 0.99) & (found[..., 0] > 0.0)
            scaled = np.clip(read(folder / "albedo.npy")[..., :3] * ratio, DARKEST, 1.0)
            wanted = np.clip(truth[..., :3], DARKEST, 1.0)
            widths.append(found[..., 0][inside])
            errors.append(np.abs(np.log(scaled / wanted)).mean(axis=-1)[inside])
        width, error = np.concatenate(widths), np.concatenate(errors)
        first = width if first is None else first
        cells = [np.median(width), rank_correlation(width, first), rank_correlation(width, error), seconds]
        print(f"| {name} | " + " | ".join(f"{value:.2f}" for value in cells) + " |", flush=True)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the benchmark."""
    parser.add_argument("run", type=Path)
    parser.add_argument("scene", type=Path)
    parser.add_argument("report", type=Path)
    parser.add_argument("--without-variants", action="store_true")


def main(arguments: argparse.Namespace) -> None:
    """Print everything for one run."""
    print_tables(pixels(arguments.scene, arguments.report))
    if not arguments.without_variants:
        print_variants(arguments.run, arguments.scene, arguments.report)
