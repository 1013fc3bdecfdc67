"""Compare materials and relit pictures of the first release's stage two with those of a preset as it is now.

    python -m benchmarks materials SUITE/cowcrate SUITE/goldbowl --environments SUITE/envmaps/high_res -o OUT

For every scene and seed, stage one is trained once. Stage two as it was in the first release, without the
polish, and the preset's own, with the polish where it has one, begin with it; both are rendered with the same
program and scored by `tests/references/evaluate.py`. Results are kept in OUT/SCENE/; what is there is not
repeated. A scene with maps of its own (`envmaps/`) is relit under them. Tables have means over seeds with the
standard errors of the mean.

*Grain* is what is left of the encoded albedo, brought to the truth's scale, after its mean over 5 x 5 pixels
is taken away, where the true albedo is the same in all of these: the root mean square, in which misplaced
edges and painted highlights have the largest part, and the median of the absolute value.
"""

import argparse
import json
import math
import multiprocessing
import resource
import statistics
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
from lambent_core.startup import prepare
from lambent_run.console_reporter import ConsoleReporter
from lambent_run.run.folder import task_seconds
from lambent_run.run.hashes import PREPARATION
from lambent_run.run.spec import RunSpec
from PIL import Image
from scipy.ndimage import maximum_filter, minimum_filter, uniform_filter

from benchmarks.reference_scores import figures_of, reference_report
from benchmarks.stage_sharing import adopt_nerf_cache
from benchmarks.switches import do_tasks, spec_of

QUICK = "{sample} --preset tiny --seeds 0 --views 1"

BEFORE = {
    "polish": "off",
    "model.materials.gloss_grid": "null",
    "model.materials.alpha_gradient": "0.25",
    "stage_two.gloss_from": "0",
    "stage_two.clusters.gloss": "1",
    "stage_two.clusters.gloss_weight": "0",
    "stage_two.metalness_prior.range": "[0.12,0.95]",
    "stage_two.metalness_prior.perceptual_roughness": "null",
    "stage_two.estimator.fast": '{"cosine":7,"sampler":5,"specular":4}',
}
"""Stage two of `fast` in the first release."""
VARIANTS: dict[str, dict[str, str]] = {"before": BEFORE, "after": {}}
WINDOW = 5
"""Pixels along a side over which albedo is uniform."""
SAME = 1.5 / 255.0
"""Difference of true albedo within a window that is uniform."""


def grain(scene: Path, predictions: Path, ratio: list[float]) -> dict[str, float]:
    """Return the grain of predicted albedo maps: encoded, root mean square and median over uniform pixels.

    `ratio` brings them to the truth's scale, per channel (`albedo_ratio` of the reference's report).
    """
    rests: list[np.ndarray] = []
    for folder in sorted(predictions.iterdir()):
        truth = np.asarray(Image.open(scene / folder.name / "albedo.png"), np.float64) / 255.0
        found = np.load(folder / "albedo.npy").astype(np.float64)[..., :3]
        found = np.clip(found * ratio, 0.0, 1.0) ** (1.0 / 2.2)
        size = (WINDOW, WINDOW, 1)
        spread = maximum_filter(truth, size) - minimum_filter(truth, size)
        uniform = (spread.max(axis=-1) < SAME) & (truth[..., 3] > 0.99)
        rests.append((found - uniform_filter(found, size))[uniform].reshape(-1))
    rest = np.concatenate(rests)
    return {
        "grain, rms": float(np.sqrt((rest**2).mean())),
        "grain, median": float(np.median(np.abs(rest))),
    }


def _polish(spec: RunSpec, folder: Path, memory: Any) -> None:
    prepare()
    do_tasks(spec, folder, *PREPARATION, "cache", "joint", "polish")
    memory.value = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0**2


def run_one(name: str, scene: Path, seed: int, arguments: argparse.Namespace) -> dict[str, float]:
    """Train, polish where it is on, evaluate, and return the figures."""
    folder = arguments.out / scene.name / f"{name}_{seed}"
    result = folder / "figures.json"
    if result.exists():
        return json.loads(result.read_text())
    spec = spec_of(VARIANTS[name], seed, arguments, scene)
    shared = arguments.out / scene.name / f"stage-one_{seed}"
    do_tasks(spec_of({}, seed, arguments, scene), shared, *PREPARATION, "cache")
    do_tasks(spec, folder / "run", *PREPARATION)
    with ConsoleReporter(folder / "run") as reporter:
        adopt_nerf_cache(folder / "run", shared, reporter)
    do_tasks(spec, folder / "run", *PREPARATION, "cache", "joint")
    polished: dict[str, float] = {}
    measured = folder / "polish.json"
    if measured.exists():
        polished = json.loads(measured.read_text())
    elif spec.config.polish == "on":
        # In a process of its own, whose largest memory is that of the polish.
        context = multiprocessing.get_context("spawn")
        memory = context.Value("d", 0.0)
        process = context.Process(target=_polish, args=(spec, folder / "run", memory))
        process.start()
        process.join()
        if process.exitcode:
            raise SystemExit(f"the polish of {folder} failed")
        polished = {"polish [s]": task_seconds(folder / "run")["polish"], "polish [GiB]": memory.value}
        measured.write_text(json.dumps(polished))
    maps = scene / "envmaps" if (scene / "envmaps").is_dir() else arguments.environments
    evaluate = [*(sys.executable, "-m", "lambent", "evaluate", str(folder / "run"), str(scene))]
    evaluate += ["--repeats", "1", "--views", str(arguments.views), "-o", str(folder / "report")]
    if maps is not None:
        evaluate += ["--environments", str(maps)]
    subprocess.run(evaluate, check=True)
    predictions = folder / "report" / "pred"
    figures = figures_of(scene, folder / "report", arguments.views)
    report = reference_report(scene, predictions, arguments.views)
    lights = {
        f"{light} [dB]": report[f"rgb/{light}/psnr"]
        for light in sorted({key.split("/")[1] for key in report if key.startswith("rgb/")})
    }
    figures |= lights | grain(scene, predictions, report["albedo_ratio"]) | polished
    result.write_text(json.dumps(figures, indent=1))
    return figures


def table(found: dict[str, dict[str, list[dict[str, float]]]]) -> str:
    """Return a table with a row per scene, figure and variant: the mean over seeds and its standard error."""
    names = list(VARIANTS)
    lines = [f"| scene | figure | {' | '.join(names)} | change |", "| --- |" + " --- |" * (len(names) + 2)]
    for scene, variants in found.items():
        for figure in variants["after"][0]:
            cells = []
            for name in names:
                values = [run[figure] for run in variants[name] if figure in run]
                cells.append(with_error(values) if values else "")
            change = ""
            if all(cells):
                pairs = zip(variants["before"], variants["after"], strict=True)
                change = with_error([after[figure] - before[figure] for before, after in pairs])
            lines.append(f"| {scene} | {figure} | {' | '.join(cells)} | {change} |")
    return "\n".join(lines)


def with_error(values: list[float]) -> str:
    """Return the mean, and the standard error where there are two or more."""
    mean = statistics.fmean(values)
    digits = 3 if abs(mean) < 2.0 else 2
    if len(values) < 2:
        return f"{mean:.{digits}f}"
    return f"{mean:.{digits}f} +- {statistics.stdev(values) / math.sqrt(len(values)):.{digits}f}"


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the benchmark."""
    parser.add_argument("scenes", type=Path, nargs="+")
    parser.add_argument(
        "--environments", type=Path, help="maps of unseen lights, for scenes without their own"
    )
    parser.add_argument("--preset", default="fast")
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2])
    parser.add_argument("--views", type=int, default=4, help="test views, evenly spaced; 0 for all")
    parser.add_argument("--set", nargs="*", default=[], metavar="KEY=VALUE", help="settings of all runs")


def main(arguments: argparse.Namespace) -> None:
    """Run both variants on every scene with every seed and print the table."""
    prepare()
    found: dict[str, dict[str, list[dict[str, float]]]] = {}
    for scene in arguments.scenes:
        found[scene.name] = {name: [] for name in VARIANTS}
    for seed in arguments.seeds:
        for scene in arguments.scenes:
            for name in VARIANTS:
                found[scene.name][name].append(run_one(name, scene, seed, arguments))
    print(f"\npreset {arguments.preset}, seeds {arguments.seeds}, {arguments.views} views\n")
    print(table(found))
