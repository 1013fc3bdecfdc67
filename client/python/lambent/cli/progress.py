"""Views of a job's updates: bars on a terminal, plain lines elsewhere, JSON for machines."""

import json
import sys
import time
from collections.abc import Callable
from dataclasses import asdict
from typing import Any, Self

from lambent.cli.output import format_duration, format_size
from lambent.models import Event, Job, Progress

PLAIN_INTERVAL_S = 10.0
"""Plain lines of one job and stage, or of a transfer, come at most this often."""


class Live:
    """Progress of a command, in a `with` statement; draws its bars, if it has any."""

    _bars: Any = None

    def __enter__(self) -> Self:
        """Start drawing."""
        if self._bars:
            self._bars.start()
        return self

    def __exit__(self, *error: object) -> None:
        """Stop drawing; the last state of the bars stays on the screen."""
        if self._bars:
            self._bars.stop()


def bars(*columns: Any) -> Any:
    """Return rich bars on standard error: a description, the bar, then `columns`."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn

    described = TextColumn("{task.description}")
    return Progress(described, BarColumn(), *columns, console=Console(stderr=True))


def describe(progress: Progress) -> str:
    """Return stage, step, share, ETA and PSNR in one line, leaving out what does not apply."""
    parts = [progress.stage or "starting"]
    if progress.num_steps:
        doing = f"{progress.doing} " if progress.doing else ""
        parts.append(f"{doing}{progress.step}/{progress.num_steps}")
    return "  ".join([*parts, f"{100 * progress.fraction:.0f} %", *_outlook(progress)])


def _outlook(progress: Progress) -> list[str]:
    eta = [f"eta {format_duration(progress.eta_s)}"] if progress.eta_s > 0 else []
    return eta + ([f"psnr {progress.psnr:.1f} dB"] if progress.psnr > 0 else [])


def describe_end(job: Job) -> str:
    """Return one line about a job that has ended."""
    if job.state == "succeeded":
        return f"{job.id} succeeded, bundle {job.bundle_id}" if job.bundle_id else f"{job.id} succeeded"
    if job.error is not None:
        return f"{job.id} {job.state}: {job.error.code}: {job.error.message}"
    return f"{job.id} {job.state}"


class JsonView(Live):
    """One JSON object per update on standard output: {"job": …} or {"event": …}."""

    def show(self, update: Event | Job) -> None:
        """Print the update."""
        print(json.dumps({type(update).__name__.lower(): asdict(update)}), flush=True)


class PlainView(Live):
    """Lines on standard error, at most one per stage and interval."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._last: dict[str, tuple[str, float]] = {}

    def show(self, update: Event | Job) -> None:
        """Print the update if it says something new."""
        line = self._line(update)
        if line:
            print(f"{time.strftime('%H:%M:%S')} {line}", file=sys.stderr, flush=True)

    def _line(self, update: Event | Job) -> str:
        if isinstance(update, Job):
            return describe_end(update) if update.is_final else f"{update.id} {update.state}"
        if update.type == "progress":
            stage, when = self._last.get(update.job_id, ("", -PLAIN_INTERVAL_S))
            if update.progress.stage == stage and self._clock() - when < PLAIN_INTERVAL_S:
                return ""
            self._last[update.job_id] = (update.progress.stage, self._clock())
            return f"{update.job_id} {describe(update.progress)}"
        return f"{update.job_id} {note}" if (note := event_note(update)) else ""


def event_note(event: Event) -> str:
    """Return the line that an event is worth, or an empty string."""
    if event.type == "state":
        run = f" (run {event.run})" if event.run > 1 else ""
        return f"{event.state}{run}" + (f": {event.message}" if event.message else "")
    if event.type == "finding":
        return f"{event.name or 'finding'}: {event.message}"
    if event.type == "artifact":
        return f"artifact {event.name}"
    return ""


class BarView(Live):
    """One live bar per job on standard error: stage, share, step, ETA, PSNR."""

    def __init__(self) -> None:
        from rich.progress import TaskProgressColumn, TextColumn

        self._bars = bars(TaskProgressColumn(), TextColumn("{task.fields[detail]}"))
        self._tasks: dict[str, Any] = {}

    def show(self, update: Event | Job) -> None:
        """Move the bar of the update's job, or print a line above the bars."""
        if isinstance(update, Job):
            task = self._task(update.id)
            if update.is_final:
                done = 1.0 if update.state == "succeeded" else None
                self._bars.update(task, completed=done, detail="", description=f"{update.id} {update.state}")
                self._bars.print(describe_end(update), markup=False)
            else:
                self._bars.update(task, description=f"{update.id} {update.state}")
                self._move(task, update.id, update.progress)
        elif update.type == "progress":
            self._move(self._task(update.job_id), update.job_id, update.progress)
        elif note := event_note(update):
            self._bars.print(f"{update.job_id} {note}", markup=False)

    def _task(self, job_id: str) -> Any:
        if job_id not in self._tasks:
            self._tasks[job_id] = self._bars.add_task(job_id, total=1.0, detail="")
        return self._tasks[job_id]

    def _move(self, task: Any, job_id: str, progress: Progress) -> None:
        if not progress.stage:
            return
        what = progress.doing or "step"
        steps = [f"{what} {progress.step}/{progress.num_steps}"] if progress.num_steps else []
        self._bars.update(
            task,
            completed=progress.fraction,
            description=f"{job_id} {progress.stage}",
            detail="  ".join([*steps, *_outlook(progress)]),
        )


def open_view(as_json: bool) -> JsonView | BarView | PlainView:
    """Return the view of jobs that suits standard error: JSON, bars or plain lines."""
    if as_json:
        return JsonView()
    return BarView() if sys.stderr.isatty() else PlainView()


class TransferView(Live):
    """Bytes of an upload or download: a bar on a terminal, now and then a line elsewhere, none with JSON."""

    def __init__(self, as_json: bool, clock: Callable[[], float] = time.monotonic) -> None:
        self._as_json = as_json
        self._clock = clock
        self._last_line = clock()
        self._tasks: dict[str, Any] = {}
        if not as_json and sys.stderr.isatty():
            from rich.progress import DownloadColumn, TransferSpeedColumn

            self._bars = bars(DownloadColumn(binary_units=True), TransferSpeedColumn())

    def show(self, what: str, done_bytes: int, total_bytes: int) -> None:
        """Show that `done_bytes` of `total_bytes` of the task `what` are done."""
        if self._as_json:
            return
        if self._bars:
            if what not in self._tasks:
                self._tasks[what] = self._bars.add_task(what, total=total_bytes)
            self._bars.update(self._tasks[what], completed=done_bytes, total=total_bytes)
            return
        if self._clock() - self._last_line >= PLAIN_INTERVAL_S:
            self._last_line = self._clock()
            size = f"{format_size(done_bytes)} of {format_size(total_bytes)}"
            print(f"{time.strftime('%H:%M:%S')} {what} {size}", file=sys.stderr, flush=True)
