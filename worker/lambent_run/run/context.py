"""The context in which a task runs."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from lambent_capture.checks.check_result import CaptureCheck
from lambent_core.errors import Stopped
from lambent_core.reporter import Reporter
from lambent_proto.v1.job_pb2 import Progress

from lambent_run.run.folder import task_folder
from lambent_run.run.spec import RunSpec

if TYPE_CHECKING:
    from flashcache.config import Config
    from flashcache.parallel.ranks import Ranks


@dataclass(kw_only=True, slots=True)
class Clock:
    """Turns the progress of one task into that of the job, and both into a time to go."""

    before: float
    """Share of the job that lies before the task, 0..1."""
    share: float
    """Share of the job that the task is, 0..1."""
    job_started: float
    """Share of the job that was done when this process began."""
    now: Callable[[], float] = time.monotonic
    began: float = field(default_factory=time.monotonic)
    """When this process began, on the clock `now`, seconds."""

    def job_fraction(self, task_fraction: float) -> float:
        """Return the share of the job that is done when `task_fraction` of the task is."""
        return self.before + self.share * min(max(task_fraction, 0.0), 1.0)

    def eta_s(self, task_fraction: float) -> float:
        """Return the seconds the rest of the job will take at the speed seen so far (0 while unknown)."""
        fraction = self.job_fraction(task_fraction)
        gained = fraction - self.job_started
        if gained <= 0.0:
            return 0.0
        return (1.0 - fraction) * (self.now() - self.began) / gained


@dataclass(frozen=True, kw_only=True, slots=True)
class TaskContext:
    """The run that a task belongs to, its folder, device and reporter."""

    spec: RunSpec
    run_dir: Path
    device: str
    reporter: Reporter
    task: str = ""
    """Name of the task."""
    checked: CaptureCheck | None = None
    """Result of a check without layout or masks whose findings were reported already."""
    clock: Clock = field(default_factory=lambda: Clock(before=0.0, share=1.0, job_started=0.0))
    num_ranks: int = 1
    """Among how many processes with a device each training is divided."""
    ranks: "Ranks | None" = None
    """The others, in such a process; only the first one writes and reports."""

    @property
    def config(self) -> "Config":
        """Return the settings of the method, which a run has from its first training on."""
        assert self.spec.config is not None, "this task has settings"
        return self.spec.config

    @property
    def leads(self) -> bool:
        """Return whether this process is the only one, or the first of several, that train."""
        return self.ranks is None or self.ranks.number == 0

    @property
    def folder(self) -> Path:
        """Return the folder of this task; a checkpoint in it was made for the same run."""
        return task_folder(self.run_dir, self.task)

    def progress(
        self,
        step: int,
        num_steps: int,
        *,
        doing: str = "",
        part: tuple[float, float] = (0.0, 1.0),
        steps_per_s: float = 0.0,
        loss: float = 0.0,
        psnr: float = 0.0,
    ) -> None:
        """Tell the reporter how far this task is; works out the job's fraction and time to go.

        Where a task does several things, `doing` says which one the steps are of, and `part` from which share
        of the task, 0..1, to which it reaches.
        """
        begin, end = part
        fraction = begin + (end - begin) * step / max(num_steps, 1)
        self.reporter.progress(
            Progress(
                stage=self.task,
                step=step,
                num_steps=num_steps,
                fraction=self.clock.job_fraction(fraction),
                eta_s=self.clock.eta_s(fraction),
                doing=doing,
                steps_per_s=steps_per_s,
                loss=loss,
                psnr=psnr,
            )
        )

    def stop_if_asked(self) -> None:
        """Raise `Stopped` where the run was asked to end; for tasks that have nothing to save."""
        if self.reporter.should_stop():
            raise Stopped
