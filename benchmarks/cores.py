"""Time steps of both stages and of the distillation in one process and in several.

    python -m benchmarks cores SUITE/cowcrate --threads 1 2 -o OUT [--set KEY=VALUE ...]

Stage one is trained for `--warm` steps first, so that rays meet something. Then each phase takes `--steps`
steps in each number of processes, all in turn, `--rounds` times. Prints median and range of the wall clock
of a step.
"""

import argparse
import copy
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import torch
from flashcache.data.hull import fit_occupancy
from flashcache.parallel.processes import Processes
from flashcache.training.optimiser import StepRecord
from flashcache.training.stage_one import StageOne
from flashcache.training.stage_two import StageTwo
from lambent_core.startup import prepare
from lambent_run.console_reporter import ConsoleReporter
from lambent_run.run.hashes import PREPARATION
from lambent_run.run.pipeline import run_pipeline
from lambent_run.run.prepare import device_for, open_task
from lambent_run.run.spec import RunSpec
from lambent_run.run.tasks.training import new_model, read_scene, training_pixels

from benchmarks.claims import Claim, claim, table

QUICK = "{sample} --preset tiny --warm 2 --steps 1 --rounds 1"
CLAIMS = "{sample} --warm 100 --steps 8 --rounds 2"
PHASES = ("stage one", "stage two", "distillation")
LATE = 0.7
"""Share of stage one after which all of its losses are on."""

Step = Callable[[], StepRecord]


def phases(run: Path, spec: RunSpec, warm: int, counts: list[int]) -> dict[tuple[str, int], Step]:
    """Return the step of each phase for each number of threads, on models of their own."""
    steps: dict[tuple[str, int], Step] = {}
    with ConsoleReporter(run) as reporter:
        run_pipeline(spec, run, device_for(run), reporter, PREPARATION)
        context = open_task(run, "cache", reporter)
        scene = read_scene(context)
        config = spec.config
        for count in counts:
            model = new_model(context, scene)
            fit_occupancy(model, scene)
            pixels = training_pixels(context, scene, model)
            begin = StageOne(model, pixels, replace(config.stage_one, num_steps=warm), seed=0)
            while not begin.finished:
                begin.step()
            # Each stage needs processes of its own, since they hold one stage at a time.
            one, two, last = (
                kind(copy.deepcopy(model), pixels, settings, seed=0, processes=Processes(count))
                for kind, settings in (
                    (StageOne, config.stage_one),
                    (StageTwo, config.stage_two),
                    (StageTwo, config.stage_two),
                )
            )
            one.steps_done = round(LATE * config.stage_one.num_steps)
            two.steps_done = config.stage_two.warmup_steps
            last.steps_done = config.stage_two.num_steps
            steps |= {(name, count): stage.step for name, stage in zip(PHASES, (one, two, last), strict=True)}
    return steps


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the benchmark."""
    parser.add_argument("scene", type=Path)
    parser.add_argument("--preset", default="fast")
    parser.add_argument("--set", nargs="*", default=[], metavar="KEY=VALUE")
    parser.add_argument("--threads", nargs="+", type=int, default=[1, 2])
    parser.add_argument("--warm", type=int, default=150)
    parser.add_argument("--steps", type=int, default=10)
    parser.add_argument("--rounds", type=int, default=4)


def main(arguments: argparse.Namespace) -> list[Claim]:
    """Print the table and return its rows."""
    prepare()
    overrides = dict(setting.split("=", 1) for setting in arguments.set)
    spec = RunSpec.from_options(arguments.scene, preset=arguments.preset, overrides=overrides, seed=0)
    steps = phases(arguments.out / "run", spec, arguments.warm, arguments.threads)
    wall: dict[tuple[str, int], list[float]] = {key: [] for key in steps}
    for number in range(arguments.rounds + 1):
        for (phase, count), step in steps.items():
            torch.set_num_threads(count)
            for _ in range(arguments.steps):
                began = time.perf_counter()
                step()
                if number:  # The first round warms up.
                    wall[phase, count].append(1e3 * (time.perf_counter() - began))
    first = arguments.threads[0]
    claims = [
        claim(f"{phase}, {count} processes for {first}", "ms", wall[phase, count], wall[phase, first])
        for phase, count in steps
        if count != first
    ]
    print(table(claims))
    return claims
