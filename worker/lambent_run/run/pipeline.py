"""Runs the tasks of a run in its folder, each once; `hashes.TASKS` are all of them."""

import time
from collections.abc import Callable
from dataclasses import replace
from importlib import import_module
from pathlib import Path

from lambent_capture.checks.check_result import CaptureCheck
from lambent_core.errors import UsageError
from lambent_core.reporter import Reporter
from lambent_core.startup import cores_in_use

from lambent_run.run.context import Clock, TaskContext
from lambent_run.run.expected import expected_seconds
from lambent_run.run.folder import (
    add_task_seconds,
    begin_task,
    done_inputs,
    finish_task,
    locked,
)
from lambent_run.run.hashes import PREPARATION, TASKS, input_hashes
from lambent_run.run.kept import drop_unfitting
from lambent_run.run.rank_processes import DIVIDED, train_by_ranks
from lambent_run.run.spec import RunSpec, keep_run


def run_pipeline(
    spec: RunSpec,
    run_dir: Path,
    device: str,
    reporter: Reporter,
    tasks: tuple[str, ...] = TASKS,
    *,
    checked: CaptureCheck | None = None,
    num_ranks: int = 1,
) -> None:
    """Run `tasks` in order, leaving out those whose results are there already, and those of other captures.

    A task that was interrupted continues from its last checkpoint. A task whose inputs (scene, lights, the
    settings it reads, an earlier task) have changed starts afresh. `checked` is the result of a
    check without layout or masks whose findings were reported already. Training is divided among `num_ranks`
    processes, with a GPU each where `device` is "cuda"; everything else uses the first. Raises `Stopped` when
    the reporter asks to end, `UsageError` where the folder holds a run with other settings,
    `SceneRefusedError` for an unusable scene, and what the tasks raise.
    """
    unknown = [name for name in tasks if name not in TASKS]
    if unknown:
        raise UsageError(
            "pipeline.step_unknown", f"unknown tasks {', '.join(unknown)}; there are {', '.join(TASKS)}"
        )
    with locked(run_dir):
        keep_run(run_dir, spec, device)
        hashes = input_hashes(spec)
        drop_unfitting(run_dir, hashes)
        tasks = tuple(name for name in TASKS if name in tasks and name in hashes)
        expected = expected_seconds(spec.config, cores_in_use(), trains_on_gpu=device != "cpu")
        total = sum(expected[name] for name in tasks)
        done = {name for name in tasks if done_inputs(run_dir, name) == hashes[name]}
        context = TaskContext(
            spec=spec,
            run_dir=run_dir,
            device=device,
            reporter=reporter,
            checked=checked,
            num_ranks=num_ranks,
            clock=Clock(before=0.0, share=0.0, job_started=sum(expected[name] for name in done) / total),
        )
        before, prepares = 0.0, True
        for name in tasks:
            share = expected[name] / total
            if prepares and name not in PREPARATION and name not in done:
                # The speed so far is that of training: what comes before depends on the photographs.
                prepares = False
                fresh = replace(context.clock, job_started=before, began=context.clock.now())
                context = replace(context, clock=fresh)
            clock = replace(context.clock, before=before, share=share)
            if name in done:
                reporter.log("step.reused", stage=name)
            else:
                run_task(replace(context, task=name, clock=clock), hashes[name])
            before += share


def run_task(context: TaskContext, inputs: str) -> None:
    """Run one task with the hash of its inputs, and mark it as done; the caller holds the run folder."""
    context.stop_if_asked()
    begin_task(context.run_dir, context.task, inputs)
    started = time.monotonic()
    context.reporter.log("step.started", stage=context.task)
    context.progress(0, 1)
    try:
        divided = context.num_ranks > 1 and context.task in DIVIDED
        (train_by_ranks if divided else _task_function(context.task))(context)
    finally:
        seconds = round(time.monotonic() - started, 2)
        add_task_seconds(context.run_dir, context.task, seconds)
    finish_task(context.run_dir, context.task, inputs)
    context.reporter.log("step.finished", stage=context.task, seconds=seconds)


def _task_function(name: str) -> Callable[[TaskContext], None]:
    """Return the function of a task; only the module that is needed is imported, and with it torch."""
    module, function = ("stages", name) if name in DIVIDED else (name, "run")
    task: Callable[[TaskContext], None] = getattr(import_module(f"lambent_run.run.tasks.{module}"), function)
    return task
