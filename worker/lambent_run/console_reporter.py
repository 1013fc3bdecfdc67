"""Tells a person or a script at the terminal how far a run is."""

import json
import sys
import time
from pathlib import Path
from types import TracebackType
from typing import TextIO

from lambent_proto.v1 import job_pb2
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn

TASK_TITLES = {
    "cameras": "finding the cameras",
    "ingest": "reading the photographs",
    "masks": "cutting the object out",
    "cache": "training the radiance cache",
    "joint": "training materials and light",
    "polish": "fitting materials and light once more",
    "evaluate": "evaluating",
    "export": "writing the bundle",
    "bake": "adapting to the light",
}
PLAIN_INTERVAL_S = 5.0


class ConsoleReporter:
    """A `Reporter` for the terminal: bars, plain lines where the output is not a terminal, or JSON lines.

    Bars and plain lines go to standard error, JSON lines to standard output. Everything is also appended to
    `log.jsonl` in the run folder, and previews are kept in `previews/`.
    """

    def __init__(
        self, run_dir: Path | None = None, *, as_json: bool = False, error: TextIO | None = None
    ) -> None:
        self._run_dir = run_dir
        self._as_json = as_json
        self._error = error or sys.stderr
        self._console = Console(file=self._error)
        self._bars: Progress | None = None
        self._task = ""
        self._last_line = 0.0
        self._stop = False

    def __enter__(self) -> "ConsoleReporter":
        if not self._as_json and self._console.is_terminal:
            self._bars = Progress(
                TextColumn("{task.fields[title]}"),
                BarColumn(bar_width=20),
                TaskProgressColumn(),
                TextColumn("{task.fields[detail]}"),
                console=self._console,
            )
            self._bars.add_task("job", total=1.0, title="", detail="")
            self._bars.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bars is not None:
            self._bars.stop()
            self._bars = None

    def request_stop(self) -> None:
        """Ask the run to end at its next step."""
        self._stop = True

    def should_stop(self) -> bool:
        """Return whether `request_stop` was called."""
        return self._stop

    def progress(self, progress: job_pb2.Progress) -> None:
        """Show how far the run is."""
        self._record(
            "progress",
            stage=progress.stage,
            step=progress.step,
            doing=progress.doing,
            num_steps=progress.num_steps,
            fraction=round(progress.fraction, 5),
            eta_s=round(progress.eta_s, 1),
            steps_per_s=round(progress.steps_per_s, 3),
            loss=progress.loss,
            psnr=round(progress.psnr, 3),
        )
        if self._as_json:
            return
        detail = describe_progress(progress)
        title = TASK_TITLES.get(progress.stage, progress.stage)
        if self._bars is not None:
            bar = self._bars.task_ids[0]
            self._bars.update(bar, completed=progress.fraction, title=title, detail=detail)
            return
        now = time.monotonic()
        ended = progress.step >= progress.num_steps
        if progress.stage != self._task or ended or now - self._last_line >= PLAIN_INTERVAL_S:
            self._print(f"{title}: {100 * progress.fraction:.0f} % of the job, {detail}")
            self._task, self._last_line = progress.stage, now

    def preview(self, name: str, png: bytes) -> None:
        """Keep a small picture of the current state in the run folder."""
        if self._run_dir is None:
            return
        folder = self._run_dir / "previews"
        folder.mkdir(parents=True, exist_ok=True)
        (folder / f"{name}.png").write_bytes(png)
        self._record("preview", name=name, path=str(folder / f"{name}.png"))

    def checkpoint(self, stage: str, step: int, folder: Path) -> None:
        """Note a checkpoint; it is on the disk already."""
        self._record("checkpoint", stage=stage, step=step, path=str(folder))

    def artifact(self, name: str, path: Path) -> None:
        """Say where a file of the result lies."""
        self._record("artifact", name=name, path=str(path))

    def finding(self, code: str, message: str, *, subject: str = "", error: bool = False) -> None:
        """Show something about the scene, and what to do."""
        self._record("finding", code=code, message=message, subject=subject, error=error)
        if not self._as_json:
            self._print(f"{'error' if error else 'note'}: {code}: {message}")

    def log(self, event: str, **fields: object) -> None:
        """Write a line for operators; not shown, since bars and lines say it better."""
        self._record(event, **fields)

    def _print(self, line: str) -> None:
        if self._bars is not None:
            self._bars.console.print(line, markup=False, highlight=False, soft_wrap=True)
        else:
            print(line, file=self._error, flush=True)

    def _record(self, event: str, **fields: object) -> None:
        line = json.dumps({"event": event, "time": round(time.time(), 3), **fields}, default=str)
        if self._as_json:
            print(line, flush=True)
        if self._run_dir is not None and self._run_dir.is_dir():
            with (self._run_dir / "log.jsonl").open("a", encoding="utf-8") as file:
                file.write(line + "\n")


def describe_progress(progress: job_pb2.Progress) -> str:
    """Return step, time to go and PSNR (dB) as words; what is unknown (zero) is left out."""
    what = progress.doing or "step"
    parts = [f"{what} {progress.step}/{progress.num_steps}"] if progress.num_steps > 1 else []
    if progress.eta_s > 0.0:
        parts.append(f"{format_duration(progress.eta_s)} to go")
    if progress.psnr > 0.0:
        parts.append(f"PSNR {progress.psnr:.1f} dB")
    return ", ".join(parts) or "started"


def format_duration(seconds: float) -> str:
    """Return a time in words, as coarse as it is useful: `45 s`, `3 min 20 s`, `2 h 5 min`."""
    whole = max(0, round(seconds))
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"
