"""Train a preset and say how every figure moves with training time.

    python -m benchmarks long_curve SUITE/cowcrate --environments SUITE/envmaps/high_res -o OUT

Keeps about `--points` checkpoints of each stage, and the polished model where the preset has a polish, then
evaluates each with `lambent evaluate` and `tests/references/evaluate.py` on `--views` test views, one repeat,
64 directions per pixel. Time is training time alone: evaluation comes after. Writes OUT/curve.csv and
OUT/curve.png. Stopped anywhere, it goes on when called again with the same arguments.
"""

import argparse
import csv
import json
import shutil
import subprocess
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from lambent_core.files import read_record
from lambent_core.startup import prepare
from lambent_run.console_reporter import ConsoleReporter
from lambent_run.run.folder import done_inputs, finish_task, task_seconds
from lambent_run.run.hashes import PREPARATION, last_training_task
from lambent_run.run.pipeline import run_pipeline
from lambent_run.run.prepare import device_for
from lambent_run.run.spec import RunSpec

from benchmarks.reference_scores import FIGURES, figures_of

QUICK = "{sample} --environments {maps} --preset tiny --points 2 --views 1 --directions 16"

TRAINING_STAGES = ("cache", "joint")
STAGES = (*TRAINING_STAGES, "polish")
OF_CACHE = ("cache novel views [dB]", "normals, inside mask [deg]")
"""Figures that mean something before materials are trained."""
COLUMNS = ("stage", "step", "stage seconds", "seconds", *FIGURES)


@dataclass(frozen=True, slots=True, order=True)
class Checkpoint:
    """A kept state of the model."""

    stage: int
    step: int
    seconds: float
    """Training time of its stage so far."""
    folder: Path

    @property
    def name(self) -> str:
        """Return the stage and the step."""
        return f"{STAGES[self.stage]}_{self.step:07d}"


class Keeper(ConsoleReporter):
    """Shows progress, and keeps copies of checkpoints that training would remove."""

    def __init__(self, run_dir: Path, kept: Path, every: dict[str, int]) -> None:
        super().__init__(run_dir)
        self._kept, self._every = kept, every

    def checkpoint(self, stage: str, step: int, folder: Path) -> None:
        """Keep a checkpoint where the last one kept is far enough behind; always the first."""
        super().checkpoint(stage, step, folder)
        last = max(
            (one.step for one in kept_checkpoints(self._kept) if STAGES[one.stage] == stage), default=0
        )
        if step - last >= self._every[stage]:
            copy_checkpoint(folder, self._kept / f"{stage}_{step:07d}")


def copy_checkpoint(source: Path, target: Path) -> None:
    """Copy what evaluation needs of a checkpoint; whole or not at all."""
    partial = target.with_name(target.name + ".partial")
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(parents=True)
    for name in ("model.safetensors", "state.json"):
        shutil.copyfile(source / name, partial / name)
    shutil.rmtree(target, ignore_errors=True)
    partial.rename(target)


def kept_checkpoints(folder: Path) -> list[Checkpoint]:
    """Return the kept states in the order of training."""
    found = []
    for path in folder.glob("*/state.json"):
        stage, _, step = path.parent.name.partition("_")
        if stage in STAGES and step.isdigit():
            seconds = float(read_record(path).get("seconds", 0.0))
            found.append(Checkpoint(STAGES.index(stage), int(step), seconds, path.parent))
    return sorted(found)


def seconds_until(checkpoint: Checkpoint, all_kept: list[Checkpoint]) -> float:
    """Return the training time until a checkpoint: that of its stage and the whole stages before it."""
    before = (max(one.seconds for one in all_kept if one.stage == stage) for stage in range(checkpoint.stage))
    return checkpoint.seconds + sum(before)


def train(spec: RunSpec, out: Path, arguments: argparse.Namespace) -> None:
    """Train as far as materials go, keeping checkpoints on the way."""
    steps = {"cache": spec.config.stage_one.num_steps, "joint": spec.config.stage_two.num_steps}
    every = {stage: max(1, round(0.99 * count / arguments.points)) for stage, count in steps.items()}
    stages = STAGES if spec.config.polish == "on" else TRAINING_STAGES
    with Keeper(out / "run", out / "kept", every) as reporter:
        device = device_for(out / "run", arguments.device)
        run_pipeline(spec, out / "run", device, reporter, (*PREPARATION, *stages))
    for stage in stages:  # The end of a stage is always worth a look.
        ended = max((out / "run" / stage).glob("step_*"))
        copy_checkpoint(ended, out / "kept" / f"{stage}_{ended.name.removeprefix('step_')}")
    if "polish" in stages:
        note_seconds(out / "kept", task_seconds(out / "run")["polish"])


def note_seconds(kept: Path, seconds: float) -> None:
    """Write how long the polish took beside its model: its checkpoint does not say it."""
    (path,) = kept.glob("polish_*/state.json")
    path.write_text(json.dumps(json.loads(path.read_text(encoding="utf-8")) | {"seconds": seconds}))


def evaluate(
    spec: RunSpec, out: Path, checkpoint: Checkpoint, arguments: argparse.Namespace
) -> dict[str, float]:
    """Return the figures of a checkpoint, in the place of the run's last one."""
    scene = arguments.scene
    probe, report = out / "probe", out / "report"
    shutil.rmtree(probe, ignore_errors=True)
    shutil.rmtree(report, ignore_errors=True)
    probe.mkdir()
    shutil.copyfile(out / "run" / "run.json", probe / "run.json")
    shutil.copytree(out / "run" / "scene", probe / "scene")
    last = last_training_task(spec.config)
    copy_checkpoint(checkpoint.folder, probe / last / f"step_{checkpoint.step:07d}")
    (probe / "steps").mkdir()
    finish_task(probe, last, f"{done_inputs(out / 'run', last)} {checkpoint.name}")
    relight = []
    if arguments.environments and checkpoint.stage:
        relight = ["--environments", str(arguments.environments)]
    options = ["--repeats", "1", "--directions", str(arguments.directions), "--views", str(arguments.views)]
    command = [sys.executable, "-m", "lambent", "evaluate", str(probe), str(scene), "-o", str(report)]
    subprocess.run([*command, *options, *relight], check=True, stdout=subprocess.DEVNULL)
    figures = figures_of(scene, report, arguments.views)
    shutil.rmtree(probe)
    shutil.rmtree(report)
    return {name: figures[name] for name in (figures if checkpoint.stage else OF_CACHE)}


def with_row(rows: list[dict[str, str]], row: dict[str, object]) -> list[dict[str, str]]:
    """Return the table with one more row, in the order of training."""
    more = [*rows, {name: str(row.get(name, "")) for name in COLUMNS}]
    return sorted(more, key=lambda one: (STAGES.index(one["stage"]), int(one["step"])))


def write_table(path: Path, rows: Iterable[dict[str, str]]) -> None:
    """Write the table as CSV; the file is there whole or as it was."""
    partial = path.with_suffix(".tmp")
    with partial.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, COLUMNS, restval="")
        writer.writeheader()
        writer.writerows(rows)
    partial.replace(path)


def read_table(path: Path) -> list[dict[str, str]]:
    """Return the rows that are there already."""
    if not path.is_file():
        return []
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def plot(rows: list[dict[str, str]], path: Path, title: str) -> None:
    """Write a panel per figure over training time; stage two is shaded."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, panels = plt.subplots(2, 5, figsize=(16, 6), layout="constrained")
    border = max((float(row["seconds"]) for row in rows if row["stage"] == "cache"), default=0.0) / 60.0
    end = max(float(row["seconds"]) for row in rows) / 60.0
    for name, panel in zip(FIGURES, panels.flat, strict=True):
        known = [(float(row["seconds"]) / 60.0, float(row[name])) for row in rows if row[name]]
        panel.plot(*zip(*known, strict=True), ".-") if known else None
        panel.axvspan(border, max(end, border), color="tab:orange", alpha=0.1)
        panel.set(title=name, xlabel="training time [min]")
    figure.suptitle(title)
    figure.savefig(path, dpi=90)
    plt.close(figure)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add what can be chosen."""
    parser.add_argument("scene", type=Path)
    parser.add_argument("--environments", type=Path, help="maps to relight with; without, no figures of that")
    parser.add_argument("--preset", default="long")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--device", default="")
    parser.add_argument("--set", dest="settings", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--points", type=int, default=8, help="checkpoints to keep of each stage")
    parser.add_argument("--views", type=int, default=8, help="test views, evenly spaced; 0 for all")
    parser.add_argument("--directions", type=int, default=64, help="secondary rays per pixel")


def main(arguments: argparse.Namespace) -> None:
    """Train, evaluate what is kept, and write the curve anew after every point."""
    prepare()
    overrides = dict(setting.split("=", 1) for setting in arguments.settings)
    spec = RunSpec.from_options(
        arguments.scene, preset=arguments.preset, overrides=overrides, seed=arguments.seed
    )
    train(spec, arguments.out, arguments)
    checkpoints = kept_checkpoints(arguments.out / "kept")
    table = arguments.out / "curve.csv"
    rows = read_table(table)
    for checkpoint in checkpoints:
        if any(
            (row["stage"], int(row["step"])) == (STAGES[checkpoint.stage], checkpoint.step) for row in rows
        ):
            continue
        figures = evaluate(spec, arguments.out, checkpoint, arguments)
        row = {
            "stage": STAGES[checkpoint.stage],
            "step": checkpoint.step,
            "stage seconds": round(checkpoint.seconds, 1),
            "seconds": round(seconds_until(checkpoint, checkpoints), 1),
            **{name: round(value, 4) for name, value in figures.items()},
        }
        rows = with_row(rows, row)
        write_table(table, rows)
        plot(rows, arguments.out / "curve.png", f"{arguments.scene.name}, preset {arguments.preset}")
        print(json.dumps(row), flush=True)
