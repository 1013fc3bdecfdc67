"""Computes the cells of a benchmark, several at a time, and keeps existing results."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from lambent_core.errors import Stopped
from lambent_core.files import read_record

from lambent_run.benchmark.cell import ORDER, RESULT, RUN
from lambent_run.benchmark.plan import CELL_FILE, Cell
from lambent_run.run.folder import done_inputs

COMMAND = (sys.executable, "-P", "-m", "lambent_run.benchmark.cell")
POLL_S = 0.2
PATIENCE_S = 60.0
"""Time limit for a process to write its checkpoint when it is terminated."""


@dataclass(frozen=True, slots=True)
class Part:
    """One part of a benchmark: a process to run."""

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
    def trained(self) -> bool:
        """Whether stage one from the same inputs exists."""
        return done_inputs(self.stage_one, "cache") == self.cell.stage_one

    @property
    def done(self) -> bool:
        """Whether a result from the same inputs exists."""
        if self.kind == "stage-one":
            return self.trained
        return read_record(self.folder / RESULT).get("inputs") == self.cell.inputs


@dataclass(slots=True)
class Running:
    """A running process."""

    part: Part
    process: subprocess.Popen[bytes]
    started: float
    slot: int


Event = Callable[[str, Part, float], None]
"""Called with "reused", "started", "finished" or "failed", the part, and the seconds it took."""


def parts_of(cells: Sequence[Cell], out: Path) -> list[Part]:
    """Return all processes of a benchmark: each stage one once, then the cells."""
    parts: dict[Path, Part] = {}
    for cell in cells:
        folder = out / "stage_one" / cell.stage_one_name
        parts.setdefault(folder, Part("stage-one", folder, cell, folder / RUN))
    for cell in cells:
        shared = out / "stage_one" / cell.stage_one_name / RUN
        parts[out / "cells" / cell.name] = Part("cell", out / "cells" / cell.name, cell, shared)
    return list(parts.values())


def run_parts(parts: Sequence[Part], *, jobs: int, devices: Sequence[str], event: Event) -> list[Part]:
    """Run the unfinished parts, at most `jobs` processes at a time, and return those that failed.

    A cell waits for its stage one. Ctrl-C or SIGTERM asks the processes to write their checkpoints and raises
    `Stopped`.
    """
    waiting = []
    for part in parts:
        if part.done:
            event("reused", part, 0.0)
        else:
            waiting.append(part)
    # A stage one whose cells are all there is not trained again.
    needed = {part.stage_one for part in waiting if part.kind == "cell"}
    waiting = [part for part in waiting if part.kind == "cell" or part.stage_one in needed]
    running: list[Running] = []
    failed: list[Part] = []
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        while waiting or running:
            running = _collect(running, failed, event)
            broken = {part.stage_one for part in failed if part.kind == "stage-one"}
            for part in [part for part in waiting if part.stage_one in broken]:
                waiting.remove(part)
                failed.append(part)
            busy = {item.part.stage_one for item in running if item.part.kind == "stage-one"}
            for part in list(waiting):
                if len(running) >= jobs:
                    break
                if part.kind == "cell" and (part.stage_one in busy or not part.trained):
                    continue
                slot = min(set(range(jobs)) - {item.slot for item in running})
                running.append(_start(part, slot, devices[slot % len(devices)], jobs))
                event("started", part, 0.0)
                waiting.remove(part)
                if part.kind == "stage-one":
                    busy.add(part.stage_one)
            time.sleep(POLL_S)
    except KeyboardInterrupt:
        raise Stopped from None
    finally:
        _end(running)
        signal.signal(signal.SIGTERM, before)
    return failed


def _start(part: Part, slot: int, device: str, jobs: int) -> Running:
    part.folder.mkdir(parents=True, exist_ok=True)
    (part.folder / ORDER).write_bytes(CELL_FILE.dump_json(part.cell, indent=1))
    threads = str(max(1, (os.cpu_count() or 1) // jobs))
    environment = {"OMP_NUM_THREADS": threads, **os.environ}
    with (part.folder / "log.txt").open("ab") as log:
        process = subprocess.Popen(
            [*COMMAND, part.kind, str(part.folder), device, str(part.stage_one)],
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
            env=environment,
            # Ctrl-C at the terminal reaches this process only; it then asks the others to end.
            start_new_session=True,
        )
    return Running(part, process, time.monotonic(), slot)


def _collect(running: list[Running], failed: list[Part], event: Event) -> list[Running]:
    """Return the processes still running, after recording how the others ended."""
    still = []
    for item in running:
        code = item.process.poll()
        if code is None:
            still.append(item)
            continue
        seconds = time.monotonic() - item.started
        if code == 0 and item.part.done:
            event("finished", item.part, seconds)
        else:
            failed.append(item.part)
            event("failed", item.part, seconds)
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
