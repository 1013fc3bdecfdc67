"""Trainings to the end in sittings of a few minutes, with their curve and figures."""

import time
from pathlib import Path
from typing import Any

from flashcache.presets import preset
from flashcache.training.checkpoint import load_checkpoint
from lambent_core.errors import Stopped
from lambent_core.files import read_record, write_json
from lambent_run.report.request import EvaluationRequest
from lambent_run.run.evaluation import evaluate_run
from lambent_run.run.folder import task_seconds
from lambent_run.run.hashes import PREPARATION
from lambent_run.run.pipeline import run_pipeline
from lambent_run.run.prepare import device_for, open_task
from lambent_run.run.spec import RunSpec
from lambent_run.run.tasks.training import new_model, read_scene

from benchmarks.long_curve import TRAINING_STAGES, Checkpoint, Keeper, copy_checkpoint, kept_checkpoints
from benchmarks.reference_scores import figures_of
from benchmarks.time_to_quality import quality

TRAINED_SHARE = 0.85
"""Of a sitting; the rest is for the curve."""


class Sitting(Keeper):
    """Keeps checkpoints for a curve, and asks the run to stop at a time (`time.monotonic`, seconds)."""

    def __init__(self, run_dir: Path, kept: Path, every: dict[str, int], ends_at: float) -> None:
        super().__init__(run_dir, kept, every)
        self.ends_at = ends_at

    def should_stop(self) -> bool:
        """Return whether the sitting is over."""
        return time.monotonic() >= self.ends_at


def training(
    scene: Path,
    folder: Path,
    *,
    preset_name: str,
    share: float,
    environments: Path | None,
    device: str,
    views: int,
    points: int,
    seconds: float,
) -> dict[str, Any]:
    """Train for at most `seconds`, from where the last sitting ended, and return what is known so far.

    `share` shortens the schedules of both stages. Once trained, test views are evaluated and relit.
    """
    began = time.monotonic()
    settings = shortened(preset_name, share)
    spec = RunSpec.from_options(scene, preset=preset_name, overrides=settings, seed=0)
    counts = {"cache": spec.config.stage_one.num_steps, "joint": spec.config.stage_two.num_steps}
    every = {stage: max(1, round(0.99 * count / points)) for stage, count in counts.items()}
    run, kept, report = folder / "run", folder / "kept", folder / "report"
    finished = False
    with Sitting(run, kept, every, began + TRAINED_SHARE * seconds) as reporter:
        device = device_for(run, device)
        try:
            run_pipeline(spec, run, device, reporter, (*PREPARATION, *TRAINING_STAGES))
            keep_ends(run, kept)
            reporter.ends_at = began + seconds
            request = EvaluationRequest(num_views=views, num_repeats=1, environments=environments)
            evaluating = time.monotonic()
            try:
                evaluate_run(run, scene, report, request, device=device, reporter=reporter)
            finally:
                add_seconds(folder / "evaluation.json", time.monotonic() - evaluating)
            finished = True
        except Stopped:
            pass
        marks = curve(run, kept, folder / "marks.json", views, reporter, began + seconds)
    used = task_seconds(run)
    evaluation_s = read_record(folder / "evaluation.json").get("seconds", 0.0)
    found = {"preset": preset_name, "scene": scene.name, "settings": settings, "steps": counts}
    found |= {"finished": finished, "seconds": used | {"evaluation": evaluation_s}, "marks": marks}
    return found | {"figures": figures_of(scene, report, views) if finished else {}}


def keep_ends(run: Path, kept: Path) -> None:
    """Keep the end of each stage, however close the checkpoint before it is."""
    for stage in TRAINING_STAGES:
        ended = max((run / stage).glob("step_*"))
        target = kept / f"{stage}_{ended.name.removeprefix('step_')}"
        if not target.is_dir():
            copy_checkpoint(ended, target)


def shortened(preset_name: str, share: float) -> dict[str, str]:
    """Return the settings that shorten both stages, and their warm-ups, to a share of the preset's steps."""
    config = preset(preset_name)
    stages = {"stage_one": config.stage_one, "stage_two": config.stage_two}
    if share == 1.0:
        return {}
    return {
        f"{name}.{what}": str(max(1, round(share * getattr(stage, what))))
        for name, stage in stages.items()
        for what in ("num_steps", "warmup_steps")
    }


def add_seconds(path: Path, seconds: float) -> None:
    """Add the time of a sitting to what a file counts."""
    write_json(path, {"seconds": read_record(path).get("seconds", 0.0) + seconds})


def curve(
    run: Path, kept: Path, path: Path, views: int, reporter: Sitting, ends_at: float
) -> list[dict[str, Any]]:
    """Return the cache's quality at the kept checkpoints; those not looked at yet are as far as time is."""
    known = read_record(path)
    waiting = [one for one in kept_checkpoints(kept) if one.name not in known]
    if waiting:
        context = open_task(run, "cache", reporter)
        scene = read_scene(context)
        for checkpoint in waiting:
            if time.monotonic() >= ends_at:
                break
            model = new_model(context, scene)
            load_checkpoint(checkpoint.folder, model)
            psnr, normals = quality(model, scene, views)
            known[checkpoint.name] = mark(checkpoint) | {"psnr": psnr, "normals": normals}
            write_json(path, known)
    return sorted(known.values(), key=lambda one: (TRAINING_STAGES.index(one["stage"]), one["step"]))


def mark(checkpoint: Checkpoint) -> dict[str, Any]:
    """Return stage, step and training seconds of the stage."""
    return {
        "stage": TRAINING_STAGES[checkpoint.stage],
        "step": checkpoint.step,
        "seconds": round(checkpoint.seconds, 1),
    }
