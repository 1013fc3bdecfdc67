"""Runs the steps of a job in a run folder, each once: ingest, cache, joint, evaluate, export."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from flashcache.config import Config, to_dict
from lambent_proto.v1 import job_pb2

from lambent_worker.errors import Stopped, UsageError
from lambent_worker.reporter import Reporter
from lambent_worker.run_folder import (
    add_step_seconds,
    begin_step,
    digest,
    done_inputs,
    file_sha256,
    finish_step,
    locked,
    step_folder,
)

STEPS = ("ingest", "cache", "joint", "evaluate", "export")

# What a step's files depend on: the step before it, and the parts of the configuration it reads.
PREVIOUS = {"cache": "ingest", "joint": "cache", "evaluate": "joint", "export": "joint"}
CONFIG_PARTS = {
    "cache": ("max_side", "space", "model", "pixels", "stage_one"),
    "joint": ("stage_two",),
    "evaluate": ("evaluation",),
    "export": ("export",),
}

# Shares of a job's time, from the time budget of preset `fast` (docs/decisions/0001-cpu-presets.md).
SHARES = {"ingest": 10.0, "cache": 110.0, "joint": 120.0, "evaluate": 30.0, "export": 80.0}


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


def run_pipeline(
    scene_dir: Path,
    run_dir: Path,
    config: Config,
    seed: int,
    device: str,
    reporter: Reporter,
    steps: tuple[str, ...] = STEPS,
    *,
    lights: tuple[str, ...] = (),
    layout: str = "",
    known_lights: Mapping[str, str] | None = None,
    masks: str = "",
) -> None:
    """Run `steps` in order, leaving out those whose results are there already.

    A step that was interrupted goes on from its last checkpoint. A step whose inputs (scene, lights, the
    settings it reads, an earlier step) have changed starts afresh. Raises `Stopped` when the reporter asks to
    end, `SceneRefusedError` for an unusable scene, and what the steps raise.
    """
    unknown = [name for name in steps if name not in STEPS]
    if unknown:
        raise UsageError(
            "pipeline.step_unknown", f"unknown steps {', '.join(unknown)}; there are {', '.join(STEPS)}"
        )
    with locked(run_dir):
        known_lights = known_lights or {}
        hashes = input_hashes(scene_dir, config, seed, lights, layout, known_lights, masks)
        total = sum(SHARES[name] for name in steps)
        done = {name for name in steps if done_inputs(run_dir, name) == hashes[name]}
        context = StepContext(
            run_dir=run_dir,
            scene_dir=scene_dir,
            config=config,
            seed=seed,
            device=device,
            reporter=reporter,
            lights=lights,
            layout=layout,
            known_lights=known_lights,
            masks=masks,
            clock=Clock(before=0.0, share=0.0, job_started=sum(SHARES[name] for name in done) / total),
        )
        before = 0.0
        for name in (name for name in STEPS if name in steps):
            share = SHARES[name] / total
            clock = replace(context.clock, before=before, share=share)
            if name in done:
                reporter.log("step.reused", stage=name)
            else:
                run_step(replace(context, stage=name, clock=clock), hashes[name])
            before += share


def run_step(context: StepContext, inputs: str) -> None:
    """Run one step with the hash of its inputs, and mark it as done; the caller holds the run folder."""
    context.stop_if_asked()
    begin_step(context.run_dir, context.stage, inputs)
    started = time.monotonic()
    context.reporter.log("step.started", stage=context.stage)
    context.progress(0, 1)
    try:
        _step_function(context.stage)(context)
    finally:
        seconds = round(time.monotonic() - started, 2)
        add_step_seconds(context.run_dir, context.stage, seconds)
    finish_step(context.run_dir, context.stage, inputs)
    context.reporter.log("step.finished", stage=context.stage, seconds=seconds)


def _step_function(name: str) -> Callable[[StepContext], None]:
    """Return the function of a step; only the module that is needed is imported, and with it torch."""
    if name == "ingest":
        from lambent_worker.steps import ingest

        return ingest.run
    if name == "cache":
        from lambent_worker.steps import cache

        return cache.run
    if name == "joint":
        from lambent_worker.steps import joint

        return joint.run
    if name == "evaluate":
        from lambent_worker.steps import evaluate

        return evaluate.run
    from lambent_worker.steps import export

    return export.run


def input_hashes(
    scene_dir: Path,
    config: Config,
    seed: int,
    lights: tuple[str, ...],
    layout: str,
    known_lights: Mapping[str, str] | None = None,
    masks: str = "",
) -> dict[str, str]:
    """Return for every step the hash of everything its result depends on."""
    given: list[object] = [dict(known_lights)] if known_lights else []
    given += [{"masks": masks}] if masks else []
    hashes = {"ingest": digest("ingest", scene_hash(scene_dir), list(lights), layout, *given)}
    for name in STEPS[1:]:
        hashes[name] = step_inputs(name, hashes[PREVIOUS[name]], config, seed)
    return hashes


def step_inputs(step: str, previous: str, config: Config, seed: int) -> str:
    """Return the hash of what a step depends on, given that of the step before it."""
    values = to_dict(config)
    return digest(step, previous, seed, {part: values[part] for part in CONFIG_PARTS[step]})


def scene_hash(scene_dir: Path) -> str:
    """Return a hash of the names and contents of all files of a capture.

    Files whose names begin with a dot do not count, and times do not, so that a copy of the capture on
    another machine is the same capture.
    """
    files = sorted(path for path in scene_dir.rglob("*") if path.is_file() and not path.name.startswith("."))
    names = [path.relative_to(scene_dir).as_posix() for path in files]
    return digest([[name, file_sha256(path)] for name, path in zip(names, files, strict=True)])
