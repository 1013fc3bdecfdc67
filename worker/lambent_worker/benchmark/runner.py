"""Computes the cells of a benchmark, several at a time, and keeps existing results."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from lambent_worker.benchmark.cell import ORDER, RESULT, RUN
from lambent_worker.benchmark.plan import Cell
from lambent_worker.errors import Stopped
from lambent_worker.files import read_record
from lambent_worker.run.folder import done_inputs

COMMAND = (sys.executable, "-m", "lambent_worker.benchmark.cell")
POLL_S = 0.2
PATIENCE_S = 60.0
"""Time limit for a process to write its checkpoint when it is terminated."""


@dataclass(frozen=True, slots=True)
class Task:
    """One process to run."""

    kind: str
    """"stage-one" or "cell"."""
    folder: Path
    cell: Cell
    stage_one: Path
    """Folder of the stage-one run that the cell starts from."""

    @property
    def title(self) -> str:
        """Return a readable title."""
        what = "stage one" if self.kind == "stage-one" else self.cell.ablation
        return f"{self.cell.scene}, {self.cell.setting} light, seed {self.cell.seed}: {what}"

    @property
    def done(self) -> bool:
        """Whether a result from the same inputs exists."""
        if self.kind == "stage-one":
            return done_inputs(self.stage_one, "cache") == self.cell.stage_one
        return read_record(self.folder / RESULT).get("inputs") == self.cell.inputs


@dataclass(slots=True)
class Running:
    """A running process."""

    task: Task
    process: subprocess.Popen[bytes]
    started: float
    slot: int


Event = Callable[[str, Task, float], None]
"""Called with "reused", "started", "finished" or "failed", the task, and the seconds it took."""


def tasks_of(cells: Sequence[Cell], out: Path) -> list[Task]:
    """Return all processes of a benchmark: each stage one once, then the cells."""
    tasks: dict[Path, Task] = {}
    for cell in cells:
        folder = out / "stage_one" / cell.stage_one_name
        tasks.setdefault(folder, Task("stage-one", folder, cell, folder / RUN))
    for cell in cells:
        shared = out / "stage_one" / cell.stage_one_name / RUN
        tasks[out / "cells" / cell.name] = Task("cell", out / "cells" / cell.name, cell, shared)
    return list(tasks.values())


def run_tasks(tasks: Sequence[Task], *, jobs: int, devices: Sequence[str], event: Event) -> list[Task]:
    """Run the unfinished tasks, at most `jobs` processes at a time, and return those that failed.

    A cell waits for its stage one. Ctrl-C or SIGTERM asks the processes to write their checkpoints and raises
    `Stopped`.
    """
    waiting = []
    for task in tasks:
        if task.done:
            event("reused", task, 0.0)
        else:
            waiting.append(task)
    # A stage one whose cells are all there is not trained again.
    needed = {task.stage_one for task in waiting if task.kind == "cell"}
    waiting = [task for task in waiting if task.kind == "cell" or task.stage_one in needed]
    running: list[Running] = []
    failed: list[Task] = []
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        while waiting or running:
            running = _collect(running, failed, event)
            broken = {task.stage_one for task in failed if task.kind == "stage-one"}
            for task in [task for task in waiting if task.stage_one in broken]:
                waiting.remove(task)
                failed.append(task)
            busy = {item.task.stage_one for item in running if item.task.kind == "stage-one"}
            for task in list(waiting):
                if len(running) >= jobs:
                    break
                if task.kind == "cell" and (task.stage_one in busy or not _is_trained(task)):
                    continue
                slot = min(set(range(jobs)) - {item.slot for item in running})
                running.append(_start(task, slot, devices[slot % len(devices)], jobs))
                event("started", task, 0.0)
                waiting.remove(task)
                if task.kind == "stage-one":
                    busy.add(task.stage_one)
            time.sleep(POLL_S)
    except KeyboardInterrupt:
        raise Stopped from None
    finally:
        _end(running)
        signal.signal(signal.SIGTERM, before)
    return failed


def _is_trained(task: Task) -> bool:
    return done_inputs(task.stage_one, "cache") == task.cell.stage_one


def _start(task: Task, slot: int, device: str, jobs: int) -> Running:
    task.folder.mkdir(parents=True, exist_ok=True)
    (task.folder / ORDER).write_text(task.cell.to_json(), encoding="utf-8")
    threads = str(max(1, (os.cpu_count() or 1) // jobs))
    environment = {"OMP_NUM_THREADS": threads, **os.environ}
    with (task.folder / "log.txt").open("ab") as log:
        process = subprocess.Popen(
            [*COMMAND, task.kind, str(task.folder), device, str(task.stage_one)],
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
            env=environment,
            # Ctrl-C at the terminal reaches this process only; it then asks the others to end.
            start_new_session=True,
        )
    return Running(task, process, time.monotonic(), slot)


def _collect(running: list[Running], failed: list[Task], event: Event) -> list[Running]:
    """Return the processes still running, after recording how the others ended."""
    still = []
    for item in running:
        code = item.process.poll()
        if code is None:
            still.append(item)
            continue
        seconds = time.monotonic() - item.started
        if code == 0 and item.task.done:
            event("finished", item.task, seconds)
        else:
            failed.append(item.task)
            event("failed", item.task, seconds)
    return still


def _end(running: Sequence[Running]) -> None:
    """Ask processes to exit, and kill those that do not."""
    for item in running:
        item.process.terminate()
    deadline = time.monotonic() + PATIENCE_S
    for item in running:
        try:
            item.process.wait(max(0.0, deadline - time.monotonic()))
        except subprocess.TimeoutExpired:
            item.process.kill()
            item.process.wait()
