"""Sharing of stage one: a run adopts the NeRF cache that another run has trained."""

from pathlib import Path

from flashcache.training.checkpoint import (
    CheckpointState,
    checkpoint_folder,
    latest_checkpoint,
    save_checkpoint,
)
from lambent_core.errors import WorkerError
from lambent_core.reporter import Reporter
from lambent_run.run.folder import begin_task, done_inputs, finish_task, task_folder
from lambent_run.run.hashes import input_hashes
from lambent_run.run.prepare import open_task
from lambent_run.run.tasks.training import new_model, read_scene
from safetensors.torch import load_file

NERF = "nerf."


def adopt_nerf_cache(run_dir: Path, other: Path, reporter: Reporter) -> None:
    """Make the NeRF cache of the run in `other` the finished stage one of a run whose scene is ingested.

    Everything else of the model is as it begins, as it would be after an own stage one. Raises `WorkerError`
    where `other` has no finished stage one, or one of another shape.
    """
    source = latest_checkpoint(task_folder(other, "cache"))
    if source is None or done_inputs(other, "cache") is None:
        raise WorkerError("run.no_stage_one", f'"{other}" has no finished stage one; train it first')
    context = open_task(run_dir, "cache", reporter)
    hashes = input_hashes(context.spec)
    if done_inputs(run_dir, "cache") == hashes["cache"]:
        return
    model = new_model(context, read_scene(context))
    tensors = load_file(source / "model.safetensors")
    learned = {name.removeprefix(NERF): value for name, value in tensors.items() if name.startswith(NERF)}
    try:
        model.nerf.load_state_dict(learned)
    except RuntimeError as error:
        raise WorkerError("run.other_shape", f'the NeRF cache of "{other}" does not fit: {error}') from error
    begin_task(run_dir, "cache", hashes["cache"])
    steps = context.spec.config.stage_one.num_steps
    state = CheckpointState(stage="cache", step=steps, seed=context.spec.seed, config_sha256="adopted")
    save_checkpoint(checkpoint_folder(task_folder(run_dir, "cache"), steps), model, None, state)
    finish_task(run_dir, "cache", hashes["cache"])
