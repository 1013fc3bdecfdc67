"""Train a preset on scenes with ground truth and print the figures of the reference evaluation.

    python -m benchmarks quality SUITE/cowcrate --seeds 0 1 2 --environments SUITE/envmaps/high_res -o OUT

Every run is a process of its own: `lambent train`, then `lambent evaluate` with 64 secondary rays per pixel.
Predictions are scored by `tests/references/evaluate.py`, which shares no code with the product: physically
based pictures, the cache's pictures, and relit pictures with and without the bounce. Results are stored in
OUT/<scene>_<seed>/; an existing run is not repeated. Time is wall-clock time of the training job,
memory the largest resident set of its processes.
"""

import argparse
import json
import re
import resource
import statistics
import subprocess
import sys
import time
from pathlib import Path

from benchmarks.reference_scores import figures_of, reference_scores

QUICK = "{sample} --environments {maps} --preset tiny --views 1"


def run_one(scene: Path, seed: int, arguments: argparse.Namespace) -> dict[str, float]:
    """Train and evaluate one seed and return its figures by row name, with seconds and memory."""
    folder = arguments.out / f"{scene.name}_{seed}"
    result = folder / "figures.json"
    if result.exists():
        return json.loads(result.read_text())
    folder.mkdir(parents=True, exist_ok=True)
    command = [sys.executable, "-m", "lambent"]
    started = time.perf_counter()
    subprocess.run(
        [*command, "train", scene, "--preset", arguments.preset, "--seed", str(seed), "-o", folder / "run"],
        check=True,
    )
    figures = {"job [s]": time.perf_counter() - started}
    figures["peak memory [GiB]"] = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 2**20
    subprocess.run(
        [
            *(*command, "evaluate", folder / "run", scene, "--environments", arguments.environments),
            *("--repeats", "1", "--views", str(arguments.views), "-o", folder / "report"),
        ],
        check=True,
    )
    figures |= figures_of(scene, folder / "report", arguments.views)
    for kind, name in (("full", "pred"), ("direct", "pred_direct")):
        scores = reference_scores(scene, folder / "report" / name, arguments.views)
        figures |= {f"{kind} {key}": scores[key] for key in scores if re.match("rgb/.*/psnr$", key)}
    result.write_text(json.dumps(figures, indent=1))
    return figures


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the benchmark."""
    parser.add_argument("scenes", nargs="+", type=Path)
    parser.add_argument("--environments", type=Path, required=True)
    parser.add_argument("--seeds", nargs="+", type=int, default=[0])
    parser.add_argument("--preset", default="fast")
    parser.add_argument("--views", type=int, default=0, help="test views, evenly spaced; 0 for all")


def main(arguments: argparse.Namespace) -> None:
    """Run everything and print one table per scene: mean, standard error over seeds, single values."""
    for scene in arguments.scenes:
        runs = [run_one(scene, seed, arguments) for seed in arguments.seeds]
        print(f"\n{scene.name}, preset {arguments.preset}, seeds {arguments.seeds}\n")
        print("| figure | mean | standard error | runs |\n| --- | --- | --- | --- |")
        for row in runs[0]:
            values = [run[row] for run in runs]
            error = statistics.stdev(values) / len(values) ** 0.5 if len(values) > 1 else float("nan")
            single = ", ".join(f"{value:.2f}" for value in values)
            print(f"| {row} | {statistics.fmean(values):.2f} | {error:.2f} | {single} |")
