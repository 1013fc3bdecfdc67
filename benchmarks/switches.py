"""Measure the gain of each switch beyond the paper: stage two trained anew for each, from a shared stage one.

    python -m benchmarks switches SUITE/cowcrate --environments SUITE/envmaps/high_res --preset fast -o OUT

Stage one is trained once per seed. Each switch then gets a run folder of its own with the shared NeRF cache
in it; its stage two is trained and evaluated, and scored by `tests/references/evaluate.py`. Results are kept
in OUT/<switch>_<seed>/; a finished run is not repeated. Seconds are those of stage two alone. With
`--variant 'NAME: KEY=VALUE ...'` settings of your own are compared in place of the switches.
"""

import argparse
import json
import statistics
import subprocess
import sys
from pathlib import Path

from lambent_core.startup import prepare
from lambent_run.console_reporter import ConsoleReporter
from lambent_run.run.folder import task_seconds
from lambent_run.run.hashes import PREPARATION
from lambent_run.run.pipeline import run_pipeline
from lambent_run.run.prepare import device_for
from lambent_run.run.spec import RunSpec

from benchmarks.reference_scores import figures_of
from benchmarks.stage_sharing import adopt_nerf_cache

QUICK = "{sample} --preset tiny --only no-clusters --views 1"

SWITCHES: dict[str, dict[str, str]] = {
    "base": {},
    "no-grey": {"stage_two.grey_weight": "0.0"},
    "no-tint": {"stage_two.tint_weight": "0.0"},
    "no-metalness-prior": {
        "stage_two.metalness_prior.weight": "0.0",
        "stage_two.metalness_prior.warmup_weight": "0.0",
    },
    "smoothness": {"stage_two.clusters.weight": "0.0", "stage_two.smoothness_weight": "0.003"},
    "no-distillation": {"stage_two.distil.num_steps": "0"},
    "no-clusters": {"stage_two.clusters.weight": "0.0"},
    "jitter": {"stage_two.secondary_jitter": "true"},
    "whole-pseudo-albedo": {"stage_two.pseudo_albedo": "radiance"},
    "cache-gradient": {"stage_two.estimator.through_cache": "1e-4"},
}
"""Settings by switch, weights as first guesses; "base" is the preset itself, "no-..." lacks a part of it."""


def compared(arguments: argparse.Namespace) -> dict[str, dict[str, str]]:
    """Return the settings to compare, by name."""
    if arguments.variant:
        return dict(arguments.variant)
    return {name: SWITCHES[name] for name in arguments.only or SWITCHES}


def spec_of(
    overrides: dict[str, str], seed: int, arguments: argparse.Namespace, scene: Path | None = None
) -> RunSpec:
    """Return a run with the preset, the settings of all runs, and `overrides`; `scene` or the only one."""
    common = dict(item.split("=", 1) for item in arguments.set)
    return RunSpec.from_options(
        scene or arguments.scene, preset=arguments.preset, overrides=common | overrides, seed=seed
    )


def do_tasks(spec: RunSpec, folder: Path, *tasks: str) -> None:
    """Do tasks of the pipeline in a run folder."""
    with ConsoleReporter(folder) as reporter:
        run_pipeline(spec, folder, device_for(folder), reporter, tasks)


def run_one(name: str, seed: int, shared: Path, arguments: argparse.Namespace) -> dict[str, float]:
    """Train stage two of a switch on the shared NeRF cache, evaluate it and return its figures."""
    folder = arguments.out / f"{name}_{seed}"
    result = folder / "figures.json"
    if result.exists():
        return json.loads(result.read_text())
    spec = spec_of(compared(arguments)[name], seed, arguments)
    do_tasks(spec, folder / "run", *PREPARATION)
    with ConsoleReporter(folder / "run") as reporter:
        adopt_nerf_cache(folder / "run", shared, reporter)
    do_tasks(spec, folder / "run", *PREPARATION, "cache", "joint", "polish")
    scene = arguments.scene
    evaluate = [*(sys.executable, "-m", "lambent", "evaluate", str(folder / "run"), str(scene))]
    evaluate += ["--repeats", "1", "--views", str(arguments.views), "-o", str(folder / "report")]
    if arguments.environments is not None:
        evaluate += ["--environments", str(arguments.environments)]
    subprocess.run(evaluate, check=True)
    figures = figures_of(scene, folder / "report", arguments.views)
    figures["stage two [s]"] = task_seconds(folder / "run")["joint"]
    result.write_text(json.dumps(figures, indent=1))
    return figures


def table(runs: dict[str, list[dict[str, float]]]) -> str:
    """Return a table: a row per switch, means over seeds, with what changed against "base" in brackets."""
    rows = list(next(iter(runs.values()))[0])
    lines = [f"| switch | {' | '.join(rows)} |", f"| --- |{' --- |' * len(rows)}"]
    for name, outcomes in runs.items():
        cells = []
        for row in rows:
            mean = statistics.fmean(run[row] for run in outcomes)
            change = ""
            if name != "base" and "base" in runs:
                change = f" ({mean - statistics.fmean(run[row] for run in runs['base']):+.2f})"
            cells.append(f"{mean:.2f}{change}")
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join(lines)


def add_variants(parser: argparse.ArgumentParser, of: str) -> None:
    """Add `--variant`; `of` says what a variant changes."""
    help_text = f"a name and the settings of {of} that differ from the preset, may be repeated"
    parser.add_argument(
        "--variant",
        action="append",
        type=variant,
        default=[],
        metavar="'NAME: KEY=VALUE ...'",
        help=help_text,
    )


def variant(text: str) -> tuple[str, dict[str, str]]:
    """Return name and settings of a variant, `NAME: KEY=VALUE KEY=VALUE`."""
    name, _, settings = text.partition(":")
    return name.strip(), dict(setting.split("=", 1) for setting in settings.split())


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the benchmark."""
    parser.add_argument("scene", type=Path)
    parser.add_argument("--environments", type=Path, help="maps of unseen lights; none: no relit pictures")
    parser.add_argument("--only", nargs="+", choices=list(SWITCHES), help="switches to run, base included")
    add_variants(parser, "stage two")
    parser.add_argument("--preset", default="fast")
    parser.add_argument("--seeds", nargs="+", type=int, default=[0])
    parser.add_argument("--views", type=int, default=0, help="test views, evenly spaced; 0 for all")
    parser.add_argument("--set", nargs="*", default=[], metavar="KEY=VALUE", help="settings of all runs")


def main(arguments: argparse.Namespace) -> None:
    """Run every switch with every seed and print the table."""
    prepare()
    names = list(compared(arguments))
    runs: dict[str, list[dict[str, float]]] = {name: [] for name in names}
    for seed in arguments.seeds:
        shared = arguments.out / f"stage-one_{seed}"
        do_tasks(spec_of({}, seed, arguments), shared, *PREPARATION, "cache")
        for name in names:
            runs[name].append(run_one(name, seed, shared, arguments))
    print(f"\n{arguments.scene.name}, preset {arguments.preset}, seeds {arguments.seeds}\n")
    print(table(runs))
