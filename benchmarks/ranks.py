"""Time steps of both stages in one process, in processes that share memory, and by ranks.

    python -m benchmarks ranks SCENE --preset fast -o OUT [--ranks 2] [--steps N] [--rounds N]

Stage one is trained for `--warm` steps first. Then each form takes `--steps` steps of each stage with one
thread per process, all in turn, `--rounds` times. Prints median and range of the wall clock of a step and of
the processor time of all processes together, as ratios to one process, and what adding the gradients takes.
"""

import argparse
import os
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

import psutil
import torch
from flashcache.parallel.processes import Processes
from flashcache.parallel.ranks import Ranks
from flashcache.parallel.shared_memory import SharedMemory
from flashcache.training.stage_one import StageOne
from flashcache.training.stage_two import StageTwo
from lambent_core.startup import prepare
from lambent_run.console_reporter import ConsoleReporter
from lambent_run.run.hashes import PREPARATION
from lambent_run.run.pipeline import run_pipeline
from lambent_run.run.prepare import device_for, open_task
from lambent_run.run.spec import RunSpec
from lambent_run.run.tasks.training import load_trained, read_scene, training_pixels

from benchmarks.claims import Claim, claim, table

QUICK = "{sample} --preset tiny --warm 2 --steps 1 --rounds 1"
STAGES = ("stage one", "stage two")
LATE = 0.7
"""Share of stage one after which all of its losses are on."""
ADDITION = "addition"


def stage_of(name: str, run: Path, **settings: Any) -> StageOne | StageTwo:
    """Return a stage late enough that all of its losses are on, on the model that the run has trained."""
    with ConsoleReporter() as reporter:
        context = open_task(run, "cache", reporter)
        scene = read_scene(context)
        model = load_trained(context, scene, "cache")
        pixels = training_pixels(context, scene, model)
    config = context.spec.config
    if name == STAGES[0]:
        one = StageOne(model, pixels, config.stage_one, seed=0, **settings)
        one.steps_done = round(LATE * config.stage_one.num_steps)
        return one
    two = StageTwo(model, pixels, config.stage_two, seed=0, **settings)
    two.steps_done = config.stage_two.warmup_steps
    return two


@dataclass
class Rank:
    """What a process of ranks does: meet the others, then take steps when it is asked to."""

    run: Path
    count: int
    meeting: Path
    ranks: Ranks | None = None
    stages: dict[str, StageOne | StageTwo] | None = None

    def __call__(self, number: int, what: str) -> int:
        """Take a step of a stage, or add numbers; return how many bytes are added in each step."""
        if self.ranks is None or self.stages is None:
            torch.set_num_threads(1)
            self.ranks = Ranks.join(
                number, self.count, self.meeting, torch.device("cpu"), step_timeout_s=600.0
            )
            self.stages = {name: stage_of(name, self.run, ranks=self.ranks) for name in STAGES}
        bucket = self.stages[STAGES[1] if what == ADDITION else what].parts._bucket
        assert bucket is not None
        if what == ADDITION:
            bucket.add()
        else:
            self.stages[what].step()
        return bucket.num_bytes


def forms(run: Path, count: int, folder: Path) -> dict[tuple[str, str], Callable[[], Any]]:
    """Return the step of each stage in each form, by stage and form."""
    found: dict[tuple[str, str], Callable[[], Any]] = {}
    for name in STAGES:
        found[name, "one process"] = stage_of(name, run).step
        found[name, "one process, fixed shapes"] = stage_of(name, run, fixed=True).step
        found[name, f"{count} processes, shared memory"] = stage_of(
            name, run, processes=Processes(count)
        ).step
    ranks, own = Processes(count), Rank(run, count, folder / "meeting")
    ranks.give([Rank(run, count, folder / "meeting") for _ in range(count - 1)], SharedMemory(1))
    for name in (*STAGES, ADDITION):
        questions = [(number, name) for number in range(count)]
        found[name, f"{count} ranks"] = partial(ranks.ask, questions, own)
    return found


def processor_s() -> float:
    """Return the processor time of this process and of those that it has started, seconds."""
    others = [child.cpu_times() for child in psutil.Process().children(recursive=True)]
    return time.process_time() + sum(times.user + times.system for times in others)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the benchmark."""
    parser.add_argument("scene", type=Path)
    parser.add_argument("--preset", default="fast")
    parser.add_argument("--ranks", type=int, default=2)
    parser.add_argument("--warm", type=int, default=150)
    parser.add_argument("--steps", type=int, default=10)
    parser.add_argument("--rounds", type=int, default=4)


def main(arguments: argparse.Namespace) -> list[Claim]:
    """Print the table and return its rows."""
    os.environ["OMP_NUM_THREADS"] = "1"
    prepare()
    torch.set_num_threads(1)
    overrides = {"stage_one.num_steps": str(arguments.warm), "stage_one.warmup_steps": "1"}
    spec = RunSpec.from_options(arguments.scene, preset=arguments.preset, overrides=overrides, seed=0)
    run = arguments.out / "run"
    with ConsoleReporter(run) as reporter:
        run_pipeline(spec, run, device_for(run), reporter, (*PREPARATION, "cache"))
    with tempfile.TemporaryDirectory() as folder:
        steps = forms(run, arguments.ranks, Path(folder))
        wall: dict[tuple[str, str], list[float]] = {key: [] for key in steps}
        used: dict[tuple[str, str], list[float]] = {key: [] for key in steps}
        num_bytes = 0
        for number in range(arguments.rounds + 1):
            for key, step in steps.items():
                before = processor_s()
                for _ in range(arguments.steps):
                    began = time.perf_counter()
                    result = step()
                    if number:  # The first round warms up.
                        wall[key].append(1e3 * (time.perf_counter() - began))
                if number:
                    # Of several steps together: that of other processes is known in hundredths of a second.
                    used[key].append(1e3 * (processor_s() - before) / arguments.steps)
                if key[0] == ADDITION:
                    num_bytes = result[0]
    claims = [
        claim(f"{stage}, {form} for one: {what}", "ms", values[stage, form], values[stage, "one process"])
        for what, values in (("wall clock", wall), ("processor time", used))
        for stage, form in steps
        if stage != ADDITION and form != "one process"
    ]
    print(table(claims))
    adding = [median(values[ADDITION, f"{arguments.ranks} ranks"]) for values in (wall, used)]
    print(f"\nadding {num_bytes / 1e6:.1f} MB: {adding[0]:.2f} ms, processor time {adding[1]:.2f} ms")
    return claims
