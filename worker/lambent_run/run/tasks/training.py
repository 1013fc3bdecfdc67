"""The parts that both training tasks share: the scene in memory, the model, and the loop around a stage."""

import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import torch
from flashcache.data.ray_batches import TrainingPixels
from flashcache.data.space import domain_of, placed
from flashcache.errors import RanksDifferError, TrainingError
from flashcache.parallel.processes import Processes
from flashcache.physical.model import Domain, InverseModel
from flashcache.training.checkpoint import (
    CheckpointState,
    checkpoint_folder,
    latest_checkpoint,
    load_checkpoint,
    prune_checkpoints,
    save_checkpoint,
)
from flashcache.training.cuda_graphs import CudaCapture
from flashcache.training.light_bake import LightBake
from flashcache.training.parts import num_parts
from flashcache.training.stage_one import StageOne
from flashcache.training.stage_two import StageTwo
from lambent_capture.loading.load import load_scene
from lambent_core.errors import Stopped
from lambent_core.files import digest, read_record
from lambent_core.scene import Scene

from lambent_run.run.capture import read_manifest
from lambent_run.run.context import TaskContext
from lambent_run.run.folder import task_folder
from lambent_run.run.hashes import last_training_task
from lambent_run.run.known_lights import give_known_lights, known_names
from lambent_run.run.live_preview import LivePreview, Orbit

Stage = StageOne | StageTwo | LightBake
REPORT_INTERVAL_S = 0.5
KEPT_PICTURES = "pictures"
"""Folder of a run with its photographs as they are trained on; it may be removed."""
SKIPPED_SHARE_LIMIT = 0.05


def read_scene(context: TaskContext) -> Scene:
    """Return the capture of the run, loaded at the preset's size."""
    config = context.config
    manifest = read_manifest(context)
    if context.ranks is not None and not context.leads:
        context.ranks.agree(0)  # The first one reads photographs first, and keeps what it reads.
    scene = load_scene(
        context.spec.scene,
        manifest,
        max_side=config.max_side,
        crop=config.crop,
        store=context.run_dir / KEPT_PICTURES,
    )
    if context.ranks is not None and context.leads:
        context.ranks.agree(0)
    return placed(scene, config.space)


def domain_for(context: TaskContext, scene: Scene) -> Domain:
    """Return the space and lights of the scene as the run's model needs them."""
    environment = context.config.model.environment
    rotated = environment.lights == "rotated"
    known = known_names(context.spec.known_lights, scene.lights, rotated=rotated)
    return domain_of(scene, context.config.space, environment, known)


def new_model(context: TaskContext, scene: Scene) -> InverseModel:
    """Return a model in its initial state, the same for the same seed, with the given environments in it."""
    torch.manual_seed(context.spec.seed)
    model = InverseModel(context.config.model, domain_for(context, scene)).to(context.device)
    give_known_lights(model, context.run_dir, context.spec.known_lights)
    return model


def load_trained(context: TaskContext, scene: Scene, task: str) -> InverseModel:
    """Return the model at the end of `task` ("cache", "joint" or "polish")."""
    model = new_model(context, scene)
    folder = latest_checkpoint(task_folder(context.run_dir, task))
    if folder is None:
        raise TrainingError(f"the run has no checkpoint of task {task!r}; train it first")
    load_checkpoint(folder, model)
    return model


def load_final(context: TaskContext, scene: Scene) -> InverseModel:
    """Return the model at the end of the training: polished, where the run's settings say so."""
    return load_trained(context, scene, last_training_task(context.spec.config))


def training_pixels(context: TaskContext, scene: Scene, model: InverseModel) -> TrainingPixels:
    """Return the training photographs on the run's device, where the model may hold something."""
    device, pixels = torch.device(context.device), context.config.pixels
    return TrainingPixels(scene, pixels, device, model.nerf.occupancy)


def processes_for(context: TaskContext, num_rays: int) -> Processes:
    """Return the processes among which the steps of a stage with batches of `num_rays` are divided.

    As many as torch may use threads, or fewer for small batches; on a GPU, and as one of several ranks, only
    this one.
    """
    on_cpu = torch.device(context.device).type == "cpu" and context.ranks is None
    return Processes(num_parts(num_rays, torch.get_num_threads() if on_cpu else 1))


def capture_for(context: TaskContext) -> CudaCapture | None:
    """Return what captures the steps of a stage as CUDA graphs; None on a processor and for ranks.

    A rank that gave its graphs up alone would no longer add gradients when the others do.
    """
    device = torch.device(context.device)
    return CudaCapture(device) if device.type == "cuda" and context.ranks is None else None


def previews_for(context: TaskContext, scene: Scene) -> LivePreview:
    """Return what shows the stage that is trained now."""
    return LivePreview(orbit=Orbit.around(scene), reporter=context.reporter, task=context.task)


def drive(context: TaskContext, stage: Stage, preview: LivePreview | None = None) -> None:
    """Take all steps of a stage, from its last checkpoint on, with progress, checkpoints and previews.

    Ranks take the same steps; the first one alone has previews, reports and writes checkpoints, and when is
    agreed after every step. Raises `Stopped` after writing a checkpoint when the reporter asks to end, and
    `TrainingError` when too many steps had gradients that were not finite.
    """
    config = context.config
    fingerprint = digest(repr(config.model), repr(stage.config))
    seconds = _resume(context, stage, fingerprint)
    saved_at = reported_at = time.monotonic()
    reported_step = stage.steps_done
    problem = None
    while not stage.finished:
        with matrix_precision(torch.device(context.device)):
            record = stage.step()
        if isinstance(stage, StageOne | StageTwo) and stage.graphs.problem != problem:
            problem = stage.graphs.problem
            context.reporter.log("graphs.given_up", step=record.step, reason=problem)
        if preview is not None and context.leads and not isinstance(stage, LightBake):
            preview.attempt(stage.model, record.step)
        now = time.monotonic()
        if now - reported_at >= REPORT_INTERVAL_S or stage.finished:
            rate = (record.step - reported_step) / max(now - reported_at, 1e-9)
            # On a GPU, this waits for all steps so far.
            record = record.read()
            context.progress(
                record.step,
                record.num_steps,
                steps_per_s=rate,
                loss=float(record.loss),
                psnr=float(record.psnr),
            )
            seconds += now - reported_at
            reported_at, reported_step = now, record.step
        if stage.num_skipped > 20 and stage.num_skipped > SKIPPED_SHARE_LIMIT * record.step:
            raise TrainingError(
                f"{stage.num_skipped} of {record.step} steps had gradients that were not finite; "
                f"lower the learning rates (for example --set stage_one.rates.network=1e-3) and start again"
            )
        stopping = context.reporter.should_stop()
        due = record.step % config.checkpoint_steps == 0 or now - saved_at >= config.checkpoint_interval_s
        if context.ranks is not None:
            stopping, due = map(bool, context.ranks.agree(stopping, due))
        if stage.finished or stopping or due:
            _save(context, stage, fingerprint, seconds)
            saved_at = time.monotonic()
        if stopping and not stage.finished:
            raise Stopped
    if preview is not None and context.leads:
        preview.tell()


@contextmanager
def matrix_precision(device: torch.device) -> Iterator[None]:
    """Let matrix products on a GPU use short factors with 32-bit sums: training only.

    Not on a processor: there, oneDNN plans 16-bit products anew for every size of a batch, and the sizes of
    stage two differ from step to step (docs/benchmarks/training-step.md).
    """
    before = torch.get_float32_matmul_precision()
    torch.set_float32_matmul_precision("medium" if device.type == "cuda" else "highest")
    try:
        yield
    finally:
        torch.set_float32_matmul_precision(before)


def _resume(context: TaskContext, stage: Stage, fingerprint: str) -> float:
    """Continue from the newest checkpoint that counts, and return the seconds trained before it.

    One counts if it can be read and was made with the settings that the stage has now, whoever made it.
    The first of several ranks chooses.
    """
    if context.ranks is None:
        return _resume_alone(context, stage, fingerprint)
    seconds = _resume_alone(context, stage, fingerprint) if context.leads else 0.0
    (step,) = context.ranks.agree(stage.steps_done)
    if step and not context.leads:
        state = load_checkpoint(checkpoint_folder(context.folder, step), stage.model, stage.optimiser)
        stage.steps_done, stage.num_skipped = state.step, state.num_skipped
    return seconds


def _resume_alone(context: TaskContext, stage: Stage, fingerprint: str) -> float:
    while (folder := latest_checkpoint(context.folder)) is not None:
        made = read_record(folder / "state.json")
        if made and (made.get("config_sha256"), made.get("seed")) != (fingerprint, context.spec.seed):
            context.reporter.log("checkpoint.other_settings", folder=folder.name)
            _set_aside(folder, "other_settings")
            continue
        try:
            state = load_checkpoint(folder, stage.model, stage.optimiser)
        except TrainingError as error:
            context.reporter.log("checkpoint.unreadable", folder=folder.name, reason=str(error))
            _set_aside(folder, "unreadable")
            continue
        stage.steps_done, stage.num_skipped = state.step, state.num_skipped
        context.reporter.log("checkpoint.resumed", stage=context.task, step=state.step)
        return state.seconds
    return 0.0


def _save(context: TaskContext, stage: Stage, fingerprint: str, seconds: float) -> None:
    if isinstance(stage, StageOne | StageTwo):
        stage.num_skipped += stage.steps.read()
    if context.ranks is not None and not context.ranks.hold_the_same(stage.model):
        raise RanksDifferError(stage.steps_done)
    if not context.leads:
        return
    state = CheckpointState(
        stage=context.task,
        step=stage.steps_done,
        seed=context.spec.seed,
        config_sha256=fingerprint,
        num_skipped=stage.num_skipped,
        seconds=seconds,
    )
    folder = checkpoint_folder(context.folder, stage.steps_done)
    save_checkpoint(folder, stage.model, stage.optimiser, state)
    prune_checkpoints(context.folder, keep=2)
    context.reporter.checkpoint(context.task, stage.steps_done, folder)
    if isinstance(stage, StageTwo):
        context.reporter.log("scale.measured", step=stage.steps_done, **stage.scale())


def _set_aside(folder: Path, why: str) -> None:
    target = folder.with_name(f"{why}_{folder.name}")
    shutil.rmtree(target, ignore_errors=True)
    folder.rename(target)
