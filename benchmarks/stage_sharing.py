"""Several runs on one stage one: a run takes over the NeRF cache that another has trained."""

from pathlib import Path

from flashcache.training.checkpoint import (
    CheckpointState,
    checkpoint_folder,
    latest_checkpoint,
    save_checkpoint,
)
from lambent_worker.errors import WorkerError
from lambent_worker.reporter import Reporter
from lambent_worker.run.folder import begin_step, done_inputs, finish_step, step_folder
from lambent_worker.run.hashes import input_hashes
from lambent_worker.run.prepare import Run, step_context
from lambent_worker.run.steps.training import new_model, read_scene
from safetensors.torch import load_file

NERF = "nerf."


def adopt_nerf_cache(run: Run, run_dir: Path, other: Path, reporter: Reporter) -> None:
    """Make the NeRF cache of the run in `other` the finished stage one of a run whose scene is ingested.

    Everything else of the model is as it begins, as it would be after an own stage one. Raises `WorkerError`
    where `other` has no finished stage one, or one of another shape.
    """
    source = latest_checkpoint(step_folder(other, "cache"))
    if source is None or done_inputs(other, "cache") is None:
        raise WorkerError("run.no_stage_one", f'"{other}" has no finished stage one; train it first')
    hashes = input_hashes(
        Path(run.scene), run.config, run.seed, run.lights, run.layout, run.known_lights, run.masks
    )
    if done_inputs(run_dir, "cache") == hashes["cache"]:
        return
    context = step_context(run, run_dir, reporter, "cache")
    model = new_model(context, read_scene(context))
    tensors = load_file(source / "model.safetensors")
    learned = {name.removeprefix(NERF): value for name, value in tensors.items() if name.startswith(NERF)}
    try:
        model.nerf.load_state_dict(learned)
    except RuntimeError as error:
        raise WorkerError("run.other_shape", f'the NeRF cache of "{other}" does not fit: {error}') from error
    begin_step(run_dir, "cache", hashes["cache"])
    steps = run.config.stage_one.num_steps
    state = CheckpointState(stage="cache", step=steps, seed=run.seed, config_sha256="adopted")
    save_checkpoint(checkpoint_folder(step_folder(run_dir, "cache"), steps), model, None, state)
    finish_step(run_dir, "cache", hashes["cache"])
