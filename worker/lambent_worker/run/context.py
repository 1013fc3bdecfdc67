"""What a step is given."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from flashcache.config import Config
from lambent_proto.v1 import job_pb2

from lambent_worker.errors import Stopped
from lambent_worker.reporter import Reporter
from lambent_worker.run.folder import step_folder


@dataclass(kw_only=True, slots=True)
class Clock:
    """Turns the progress of one step into that of the job, and both into a time to go."""

    before: float
    """Share of the job that lies before the step, 0..1."""
    share: float
    """Share of the job that the step is, 0..1."""
    job_started: float
    """Share of the job that was done when this process began."""
    now: Callable[[], float] = time.monotonic
    began: float = field(default_factory=time.monotonic)
    """When this process began, on the clock `now`, seconds."""

    def job_fraction(self, step_fraction: float) -> float:
        """Return the share of the job that is done when `step_fraction` of the step is."""
        return self.before + self.share * min(max(step_fraction, 0.0), 1.0)

    def eta_s(self, step_fraction: float) -> float:
        """Return the seconds the rest of the job will take at the speed seen so far (0 while unknown)."""
        fraction = self.job_fraction(step_fraction)
        gained = fraction - self.job_started
        if gained <= 0.0:
            return 0.0
        return (1.0 - fraction) * (self.now() - self.began) / gained


@dataclass(frozen=True, kw_only=True, slots=True)
class StepContext:
    """What a step gets: where to work, with which settings, and whom to tell."""

    run_dir: Path
    scene_dir: Path
    config: Config
    seed: int
    device: str
    reporter: Reporter
    stage: str = ""
    """Name of the step."""
    lights: tuple[str, ...] = ()
    """Training lights by name; empty for the scene's first."""
    layout: str = ""
    """Layout to read the scene as; empty to detect it."""
    known_lights: Mapping[str, str] = field(default_factory=dict)
    """Names of kept environment files by light; see `known_lights`."""
    masks: str = ""
    """Where masks come from; see `RunSettings.masks`."""
    clock: Clock = field(default_factory=lambda: Clock(before=0.0, share=1.0, job_started=0.0))

    @property
    def folder(self) -> Path:
        """Return the folder of this step; a checkpoint that lies there was made from the same inputs."""
        return step_folder(self.run_dir, self.stage)

    def progress(
        self, step: int, num_steps: int, *, steps_per_s: float = 0.0, loss: float = 0.0, psnr: float = 0.0
    ) -> None:
        """Tell the reporter how far this step is; works out the job's fraction and time to go."""
        fraction = step / max(num_steps, 1)
        self.reporter.progress(
            job_pb2.Progress(
                stage=self.stage,
                step=step,
                num_steps=num_steps,
                fraction=self.clock.job_fraction(fraction),
                eta_s=self.clock.eta_s(fraction),
                steps_per_s=steps_per_s,
                loss=loss,
                psnr=psnr,
            )
        )

    def stop_if_asked(self) -> None:
        """Raise `Stopped` where the run was asked to end; for steps that have nothing to save."""
        if self.reporter.should_stop():
            raise Stopped
