"""The uncertainty of a run's materials: measured once, in the evaluation task, and kept in the run folder."""

from pathlib import Path

import numpy as np
from flashcache.physical.model import InverseModel
from flashcache.polish.confidence import FILE as CONFIDENCE
from flashcache.polish.confidence import Confidence
from lambent_core.files import whole_file
from lambent_core.scene import Scene
from lambent_relight.bundle.uncertainty import CHANNELS, UncertaintyGrid

from lambent_run.report.request import rule_of
from lambent_run.report.uncertainty import measure_uncertainty
from lambent_run.run.context import TaskContext
from lambent_run.run.folder import done_inputs, task_folder
from lambent_run.run.hashes import last_training_task

FILE = "uncertainty.npz"


def kept_uncertainty(run_dir: Path) -> UncertaintyGrid | None:
    """Return what the evaluation task measured for the trained model of a run, or None where it did not."""
    path = task_folder(run_dir, "evaluate") / FILE
    if not path.is_file():
        return None
    with np.load(path, allow_pickle=False) as stored:
        if str(stored["trained"]) != _trained(run_dir):
            return None
        return UncertaintyGrid(stored["low"], stored["high"], stored["values"], CHANNELS)


def keep_uncertainty(run_dir: Path, grid: UncertaintyGrid) -> None:
    """Write the grid beside the evaluation, with the hash of what it was measured on."""
    path = task_folder(run_dir, "evaluate") / FILE
    trained = np.array(_trained(run_dir))
    with whole_file(path) as partial, partial.open("wb") as file:
        np.savez(file, values=grid.values, low=grid.low, high=grid.high, trained=trained)


def uncertainty_of_run(context: TaskContext, model: InverseModel, scene: Scene) -> UncertaintyGrid | None:
    """Return the uncertainty of a run's materials, measured now unless it was; `scene` is the training scene.

    None where the configuration leaves it out, or the model has no surface.
    """
    kept = kept_uncertainty(context.run_dir)
    num_points = context.config.evaluation.uncertainty_points
    if kept is not None or not num_points:
        return kept
    return measure_uncertainty(
        model,
        scene,
        seed=context.spec.seed,
        rule=rule_of(context.config.stage_two),
        num_points=num_points,
        confidence=polished_confidence(context),
    )


def polished_confidence(context: TaskContext) -> Confidence | None:
    """Return how sure the polish is of what it fitted.

    None where the run has no finished polish, where that kept stage two's materials, and where it is of an
    older version.
    """
    path = task_folder(context.run_dir, "polish") / CONFIDENCE
    polished = last_training_task(context.spec.config) == "polish"
    if not polished or done_inputs(context.run_dir, "polish") is None or not path.is_file():
        return None
    return Confidence.load(path)


def _trained(run_dir: Path) -> str:
    """Return the hash of the inputs of the task that changed the model last."""
    return done_inputs(run_dir, "polish") or done_inputs(run_dir, "joint") or ""
