"""Runs the steps of a job in a run folder, each once: ingest, cache, joint, evaluate, export."""

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

from flashcache.config import Config

from lambent_worker.errors import UsageError
from lambent_worker.reporter import Reporter
from lambent_worker.run.context import Clock, StepContext
from lambent_worker.run.folder import (
    add_step_seconds,
    begin_step,
    done_inputs,
    finish_step,
    locked,
)
from lambent_worker.run.hashes import STEPS, input_hashes

# Shares of a job's time, from the time budget of preset `fast` (docs/decisions/0001-cpu-presets.md).
SHARES = {"ingest": 10.0, "cache": 110.0, "joint": 120.0, "evaluate": 30.0, "export": 80.0}


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
        from lambent_worker.run.steps import ingest

        return ingest.run
    if name == "cache":
        from lambent_worker.run.steps import cache

        return cache.run
    if name == "joint":
        from lambent_worker.run.steps import joint

        return joint.run
    if name == "evaluate":
        from lambent_worker.run.steps import evaluate

        return evaluate.run
    from lambent_worker.run.steps import export

    return export.run
