"""Spreads pictures over processes. A picture that fails, or kills its process, stops no other."""

import contextlib
import multiprocessing
import traceback
from collections import deque
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, field
from functools import partial
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

from lambent_compute.group_signals import held_back, ignore
from lambent_compute.threads import available_threads
from lambent_core.errors import RelightError

from lambent_relight.batch.journal import Record
from lambent_relight.batch.manifest import Files
from lambent_relight.batch.plan import Failure, Row
from lambent_relight.batch.studio import KEPT_RAYS, Studio

Task = tuple[Row, tuple[str, ...]]
"""A picture, and the suffixes of the files to write of it."""
Progress = Callable[[float], None]
_END_S = 5.0


def run_tasks(
    tasks: Sequence[Task],
    folder: Path,
    files: Files,
    *,
    num_jobs: int = 1,
    progress: Progress | None = None,
    strict: bool = False,
) -> Generator[tuple[Row, Record | Failure], None, None]:
    """Make pictures and yield each as it is done, made or failed; the order is kept with one process only.

    `num_jobs` processes share the processor's threads. `progress` is called with the finished fraction of the
    picture in work, with one process only; there `strict` raises what a picture fails with. An iterator
    that is closed early ends the processes.
    """
    num_jobs = min(num_jobs, len(tasks))
    # Views are worth remembering only where a camera comes again, in another light or quality.
    looks = {(row.asset.name, row.light.name, row.quality.name) for row, _ in tasks}
    kept_rays = KEPT_RAYS if len(looks) > len({row.asset.name for row, _ in tasks}) else 0
    if num_jobs <= 1:
        studio = Studio(folder, files, kept_rays=kept_rays)
        for row, suffixes in tasks:
            make = studio.make if strict else partial(attempt, studio)
            yield row, make(row, suffixes, progress)
        return
    num_threads = max(1, available_threads() // num_jobs)
    lanes = _Lanes(tasks, num_jobs)
    workers = [_Worker(index, folder, files, num_threads, kept_rays) for index in range(num_jobs)]
    try:
        for worker in workers:
            worker.give(lanes.next(worker.index))
        while any(worker.task is not None for worker in workers):
            busy = [worker for worker in workers if worker.task is not None]
            ready = set(wait([worker.pipe for worker in busy]))
            for worker in busy:
                if worker.pipe in ready and worker.task is not None:
                    row = worker.task[0]
                    result = worker.collect()
                    worker.give(lanes.next(worker.index))
                    yield row, result
    finally:
        for worker in workers:
            worker.end()


def attempt(
    studio: Studio, row: Row, suffixes: Sequence[str], progress: Progress | None = None
) -> Record | Failure:
    """Return the record of a picture, or why there is none."""
    try:
        return studio.make(row, suffixes, progress)
    except RelightError as error:
        return Failure(path=row.path, code=error.code, message=f"{error.message}; {error.advice}")
    except MemoryError:
        return Failure(path=row.path, code="batch.memory", message="too little memory; use fewer --jobs")
    except OSError as error:
        return Failure(path=row.path, code="batch.io", message=str(error))
    except Exception as error:
        # Not one of ours: the list of failures must still name it, and the traceback says where.
        traceback.print_exc()
        return Failure(path=row.path, code="batch.unexpected", message=f"{type(error).__name__}: {error}")


class _Lanes:
    """Hands out tasks: each process goes along its own stretch, which shares bundles, maps and views."""

    def __init__(self, tasks: Sequence[Task], num_lanes: int) -> None:
        ends = [round(len(tasks) * index / num_lanes) for index in range(num_lanes + 1)]
        self._lanes = [deque(tasks[ends[index] : ends[index + 1]]) for index in range(num_lanes)]

    def next(self, index: int) -> Task | None:
        """Return the next task of a lane, or the last of the longest one; None when all are done."""
        if self._lanes[index]:
            return self._lanes[index].popleft()
        longest = max(self._lanes, key=len)
        return longest.pop() if longest else None


@dataclass(slots=True)
class _Worker:
    """One process and what it works on."""

    index: int
    folder: Path
    files: Files
    num_threads: int
    kept_rays: int
    task: Task | None = None
    pipe: Connection = field(init=False)
    process: Any = field(init=False)

    def __post_init__(self) -> None:
        self._start()

    def _start(self) -> None:
        context = multiprocessing.get_context("spawn")
        self.pipe, theirs = context.Pipe()
        arguments = (theirs, self.folder, self.files, self.num_threads, self.kept_rays)
        self.process = context.Process(target=_serve, args=arguments, daemon=True)
        # Until the process has come to `_serve`.
        with held_back("SIGINT"):
            self.process.start()
        theirs.close()

    def give(self, task: Task | None) -> None:
        """Hand over a task; None lets the process end."""
        self.task = task
        with contextlib.suppress(OSError):  # a process that is gone is found when its result is collected
            self.pipe.send(task)

    def collect(self) -> Record | Failure:
        """Return the result of the task; a process that died is replaced."""
        assert self.task is not None
        try:
            result: Record | Failure = self.pipe.recv()
        except (EOFError, OSError):
            self.process.join()
            code = self.process.exitcode
            how = f"signal {-code}" if code is not None and code < 0 else f"code {code}"
            result = Failure(
                path=self.task[0].path,
                code="batch.worker_died",
                message=f"the process that rendered it ended with {how}, perhaps for lack of memory",
            )
            self.pipe.close()
            self._start()
        return result

    def end(self) -> None:
        """End the process: at once where it is at work."""
        if self.task is not None:
            self.process.terminate()
        self.process.join(_END_S)
        if self.process.is_alive():
            self.process.kill()
            self.process.join()
        self.pipe.close()


def _serve(pipe: Connection, folder: Path, files: Files, num_threads: int, kept_rays: int) -> None:
    # Ctrl-C reaches every process of a terminal; the first one decides what to do about it.
    ignore("SIGINT")
    studio = Studio(folder, files, num_threads=num_threads, kept_rays=kept_rays)
    with contextlib.suppress(EOFError, BrokenPipeError):
        while (task := pipe.recv()) is not None:
            pipe.send(attempt(studio, *task))
