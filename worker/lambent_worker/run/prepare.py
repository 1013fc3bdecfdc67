"""What `lambent train` and `lambent export` do around the pipeline: settings, folders, refusals."""

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

from flashcache.config import Config, from_dict, to_dict, with_overrides
from flashcache.errors import ConfigError
from flashcache.presets import preset as preset_of

from lambent_worker.errors import UsageError
from lambent_worker.reporter import Reporter
from lambent_worker.run.context import StepContext
from lambent_worker.run.folder import (
    RunSettings,
    done_inputs,
    locked,
    read_settings,
    step_folder,
    write_settings,
)
from lambent_worker.run.hashes import step_inputs
from lambent_worker.run.known_lights import keep_known_lights, names_by_content, parse_known_lights
from lambent_worker.run.masks import forget_masks, keep_masks, masks_setting
from lambent_worker.run.pipeline import run_step


@dataclass(frozen=True, kw_only=True, slots=True)
class Run:
    """A run folder's settings, ready for the pipeline."""

    config: Config
    seed: int
    device: str
    lights: tuple[str, ...]
    layout: str
    known_lights: Mapping[str, str]
    """Kept environment files by light."""
    masks: str
    """Where masks come from; see `RunSettings.masks`."""
    scene: str
    """Folder of the capture the run was trained on."""


def prepare_run(
    scene_dir: Path,
    run_dir: Path,
    *,
    preset: str,
    lights: tuple[str, ...],
    layout: str,
    seed: int,
    device: str,
    overrides: Mapping[str, str],
    resume: bool,
    known_lights: Sequence[str] = (),
    masks: Path | None = None,
    whole_view: bool = False,
) -> Run:
    """Return the run to do in `run_dir`, made new or found there.

    With `resume` every setting but `device` comes from the folder. Without, the settings must be those of the
    run that is there, if there is one. Raises `UsageError` for a folder that holds something else, an unknown
    preset or a missing device, and `ConfigError` for a wrong setting. `masks` is a folder of masks;
    `whole_view` takes everything in view for the object where there are none.
    """
    if resume:
        return open_run(run_dir, device)
    config = config_for(preset, overrides)
    files = parse_known_lights(known_lights)
    wanted = RunSettings(
        preset=preset,
        config=to_dict(config),
        seed=seed,
        device=device or "cpu",
        lights=lights,
        layout=layout,
        known_lights=names_by_content(files),
        masks=masks_setting(masks, whole_view=whole_view),
        scene=str(scene_dir.resolve()),
    )
    if (run_dir / "run.json").exists():
        found = read_settings(run_dir)
        if _only_masks_differ(found, wanted) and done_inputs(run_dir, "ingest") is None:
            # The masks were refused, and have been mended.
            forget_masks(run_dir)
            if masks is not None:
                keep_masks(run_dir, masks)
            write_settings(run_dir, wanted)
        _refuse_other_settings(run_dir, read_settings(run_dir), wanted)
        return open_run(run_dir, device)
    if run_dir.exists() and (not run_dir.is_dir() or any(run_dir.iterdir())):
        raise UsageError(
            "run.folder_not_empty", f'"{run_dir}" exists and holds no run; choose another folder with -o'
        )
    check_device(wanted.device)
    keep_known_lights(run_dir, files)
    if masks is not None:
        keep_masks(run_dir, masks)
    write_settings(run_dir, wanted)
    return _as_run(wanted)


def config_for(name: str, overrides: Mapping[str, str]) -> Config:
    """Return a preset, or `PRESET:SCENE` for a published scene, with settings changed.

    Raises `UsageError` for an unknown name and `ConfigError` for a wrong setting.
    """
    try:
        base = preset_of(name)
    except ConfigError as error:
        raise UsageError("config.preset_unknown", f'--preset "{name}": {error}') from error
    return with_overrides(base, overrides)


def open_run(run_dir: Path, device: str = "") -> Run:
    """Return the settings of the run in `run_dir`, on its own device unless `device` names another."""
    settings = read_settings(run_dir)
    if device:
        settings = replace(settings, device=device)
    check_device(settings.device)
    return _as_run(settings)


def check_device(device: str) -> None:
    """Raise `UsageError` where torch has no such device here."""
    import torch

    try:
        found = torch.device(device).type in ("cpu", "cuda")
        if found and torch.device(device).type == "cuda":
            found = (torch.device(device).index or 0) < torch.cuda.device_count()
    except RuntimeError:
        found = False
    if not found:
        raise UsageError(
            "device.not_found", f'--device "{device}" is not there; use cpu, or cuda where torch finds a GPU'
        )


def export_run(run_dir: Path, out: Path, reporter: Reporter, *, tier: str = "", weights: str = "") -> None:
    """Write the bundle of a trained run to `out`, making it first if the run has none like it.

    `tier` is "full" or "lite" (which leaves the networks out unless `weights` says otherwise), `weights` as
    in the settings; empty ones are the run's. Raises `UsageError` where the run is not trained to its end or
    `out` exists, `ConfigError` for unknown values.
    """
    run = open_run(run_dir)
    wanted = {"transport_tier": tier, "weights": weights or ("none" if tier == "lite" else "")}
    settings = {f"export.{name}": value for name, value in wanted.items() if value}
    run = replace(run, config=with_overrides(run.config, settings))
    if out.exists():
        raise UsageError("export.exists", f'"{out}" exists already; choose another folder with -o')
    trained = done_inputs(run_dir, "joint")
    if trained is None:
        raise UsageError(
            "run.not_trained",
            f'the run in "{run_dir}" is not finished; run lambent train with --resume first',
        )
    inputs = step_inputs("export", trained, run.config, run.seed)
    with locked(run_dir):
        if done_inputs(run_dir, "export") != inputs:
            run_step(step_context(run, run_dir, reporter, "export"), inputs)
        partial = out.with_name(out.name + ".partial")
        shutil.rmtree(partial, ignore_errors=True)
        shutil.copytree(step_folder(run_dir, "export"), partial)
        partial.rename(out)


def step_context(run: Run, run_dir: Path, reporter: Reporter, stage: str) -> StepContext:
    """Return the context in which a single step of a run works outside the pipeline."""
    return StepContext(
        run_dir=run_dir,
        scene_dir=Path(run.scene),
        config=run.config,
        seed=run.seed,
        device=run.device,
        reporter=reporter,
        stage=stage,
        lights=run.lights,
        layout=run.layout,
        known_lights=run.known_lights,
        masks=run.masks,
    )


def _as_run(settings: RunSettings) -> Run:
    return Run(
        config=from_dict(Config, settings.config),
        seed=settings.seed,
        device=settings.device,
        lights=settings.lights,
        layout=settings.layout,
        known_lights=settings.known_lights,
        masks=settings.masks,
        scene=settings.scene,
    )


def _only_masks_differ(found: RunSettings, wanted: RunSettings) -> bool:
    return found.masks != wanted.masks and replace(found, masks=wanted.masks) == wanted


def _refuse_other_settings(run_dir: Path, found: RunSettings, wanted: RunSettings) -> None:
    if found == wanted:
        return
    differing = [
        item.name
        for item in fields(RunSettings)
        if item.compare and getattr(found, item.name) != getattr(wanted, item.name)
    ]
    raise UsageError(
        "run.other_settings",
        f'"{run_dir}" holds a run with another {", ".join(differing)}; choose another folder with -o, or '
        "give --resume to go on with the settings it has",
    )
