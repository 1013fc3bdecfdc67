"""Steps of the commands around the pipeline: devices, folders, refusals, the bundle of a trained run."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

from google.protobuf import json_format
from lambent_capture.masks.corrections import NAME
from lambent_capture.masks.editing import Editing
from lambent_capture.masks.estimate import not_credible
from lambent_core.errors import UsageError
from lambent_core.reporter import Reporter
from lambent_proto.v1.bundle_pb2 import BundleManifest

from lambent_run.run.capture import needs_masks
from lambent_run.run.context import TaskContext
from lambent_run.run.export_notes import tell_about
from lambent_run.run.folder import done_inputs, locked, require_done, task_folder
from lambent_run.run.hashes import last_training_task, task_inputs
from lambent_run.run.masks import AUTOMATIC
from lambent_run.run.pipeline import run_task
from lambent_run.run.spec import RunSpec, read_run, run_record, training_has_begun, unused_corrections


def device_for(run_dir: Path, device: str = "", num_ranks: int = 1) -> str:
    """Return the device to run on in `run_dir`: the one that is asked for, that of the run there, or the CPU.

    Raises `UsageError` for a missing device, for fewer GPUs than `num_ranks` where they are asked for, and
    for a folder that holds something else.
    """
    if (run_dir / "run.json").exists():
        device = device or run_record(run_dir)["device"]
    elif run_dir.exists() and (not run_dir.is_dir() or any(p.name != ".lock" for p in run_dir.iterdir())):
        raise UsageError(
            "run.folder_not_empty", f'"{run_dir}" exists and holds no run; choose another folder with -o'
        )
    device = device or "cpu"
    check_device(device)
    if num_ranks > 1 and device != "cpu":
        if device != "cuda":
            raise UsageError(
                "device.of_ranks",
                f'--device "{device}" is one GPU; use cuda with --ranks, which takes the first',
            )
        check_device(f"cuda:{num_ranks - 1}")
    return device


def open_task(run_dir: Path, task: str, reporter: Reporter, device: str = "") -> TaskContext:
    """Return the context in which one task of the run in `run_dir` works outside the pipeline.

    It is on the run's own device unless `device` names another. Raises `UsageError` where there is no run.
    """
    spec, own = read_run(run_dir)
    check_device(device or own)
    return TaskContext(spec=spec, run_dir=run_dir, device=device or own, reporter=reporter, task=task)


def preparation_of(scene: Path, run_dir: Path, layout: str = "") -> RunSpec:
    """Return the specification of the run in `run_dir`, or of one that is to be prepared there.

    What comes before the training is the same for every preset, so that a new one has none yet.
    """
    if (run_dir / "run.json").exists():
        return replace(read_run(run_dir)[0], scene=scene)
    return RunSpec(scene=scene, config=None, layout=layout)


def has_settings(run_dir: Path) -> bool:
    """Return whether there is a run in `run_dir` that has settings of the method, which torch reads."""
    return (run_dir / "run.json").exists() and run_record(run_dir)["config"] is not None


def check_correctable(spec: RunSpec, run_dir: Path) -> None:
    """Raise `UsageError` where the masks of a run are not estimated, or were trained with already."""
    if spec.masks != AUTOMATIC:
        raise unused_corrections("this run has given ones, or none")
    if training_has_begun(run_dir):
        raise UsageError(
            "run.training_begun",
            f'"{run_dir}" was trained with the masks it has; correct them in another folder with -o '
            f'(a copy of "{run_dir / NAME}", given to lambent train by --corrections, takes the ones over)',
        )


def editing_of(run_dir: Path, reporter: Reporter) -> Editing:
    """Return what a person corrects in a run whose capture was read; the caller holds its folder.

    Masks that are not estimated yet are, without drawing them. Raises `UsageError` where the capture has
    masks, and `SceneRefusedError` where its views cannot be compared.
    """
    from lambent_run.run.tasks import masks

    context = open_task(run_dir, "masks", reporter)
    if not needs_masks(context):
        raise unused_corrections("this capture brings its own")
    workspace = masks.found_object(context)
    if isinstance(workspace, str):
        raise not_credible(workspace)
    return Editing(workspace, masks.photographs(context))


def check_device(device: str) -> None:
    """Raise `UsageError` where torch has no such device here; the CPU is there without torch."""
    if device == "cpu":
        return
    import torch

    try:
        exists = torch.device(device).type in ("cpu", "cuda")
        if exists and torch.device(device).type == "cuda":
            exists = (torch.device(device).index or 0) < torch.cuda.device_count()
    except RuntimeError:
        exists = False
    if not exists:
        raise UsageError(
            "device.not_found", f'--device "{device}" is not there; use cpu, or cuda where torch finds a GPU'
        )


def export_run(
    run_dir: Path,
    out: Path,
    reporter: Reporter,
    *,
    tier: str = "",
    weights: str = "",
    faces: str = "",
    atlas: str = "",
) -> None:
    """Write the bundle of a trained run to `out`, making it first if the run has none like it.

    `tier` is "full" or "lite" (which leaves the networks out unless `weights` says otherwise), `weights` as
    in the settings, `faces` a number of triangles or "auto", `atlas` the side of the albedo texture or
    "auto"; empty ones are the run's. Raises `UsageError` where the run is not trained to its end or `out`
    exists, `ConfigError` for unknown values.
    """
    from flashcache.config import with_overrides

    context = open_task(run_dir, "export", reporter)
    previous = require_done(run_dir, last_training_task(context.spec.config))
    wanted = {"transport_tier": tier, "weights": weights or ("none" if tier == "lite" else "")}
    wanted["faces"] = "0" if faces == "auto" else faces
    wanted["atlas_size"] = "0" if atlas == "auto" else atlas
    # Stated too, so that a texture with fewer texels is refused and does not make transport coarser.
    wanted["transport_size"] = str(context.config.export.transport_size)
    settings = {f"export.{name}": value for name, value in wanted.items() if value}
    config = with_overrides(context.config, settings)
    if out.exists():
        raise UsageError("export.exists", f'"{out}" exists already; choose another folder with -o')
    inputs = task_inputs("export", previous, config, context.spec.seed)
    with locked(run_dir):
        made = task_folder(run_dir, "export")
        if done_inputs(run_dir, "export") != inputs:
            run_task(replace(context, spec=replace(context.spec, config=config)), inputs)
        else:
            record = json.loads((made / "manifest.json").read_text(encoding="utf-8"))
            manifest = json_format.ParseDict(record, BundleManifest(), ignore_unknown_fields=True)
            tell_about(reporter, manifest, config.export)
        partial = out.with_name(out.name + ".partial")
        shutil.rmtree(partial, ignore_errors=True)
        shutil.copytree(made, partial)
        partial.rename(out)
