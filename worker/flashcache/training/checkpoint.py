"""Checkpoints: tensors in safetensors, everything else in JSON; nothing is ever unpickled.

A checkpoint is a folder: `model.safetensors`, `optimiser.safetensors` (absent once training of the
stage is over), `extra.safetensors` where a stage keeps more than these, and `state.json`. It is either
complete or absent: it is written under another name and renamed.
"""

import json
import os
import shutil
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import nn

from flashcache.errors import TrainingError

SCHEMA_VERSION = 1


@dataclass(frozen=True, kw_only=True, slots=True)
class CheckpointState:
    """The metadata of a checkpoint."""

    stage: str
    step: int
    """Steps of the stage that are done."""
    seed: int
    config_sha256: str
    num_skipped: int = 0
    seconds: float = 0.0
    """Training time of the stage so far."""
    schema_version: int = SCHEMA_VERSION


def save_checkpoint(
    folder: Path,
    model: nn.Module,
    optimiser: torch.optim.Optimizer | None,
    state: CheckpointState,
) -> Path:
    """Write a checkpoint to `folder`, replacing an earlier one, and return the folder.

    It is built next to its place, flushed to disk and renamed, so that a kill leaves the old or the new one.
    """
    temporary = folder.with_name(folder.name + ".tmp")
    shutil.rmtree(temporary, ignore_errors=True)
    temporary.mkdir(parents=True)
    tensors = {name: value.detach().cpu().contiguous() for name, value in model.state_dict().items()}
    save_file(tensors, temporary / "model.safetensors")
    if optimiser is not None:
        save_file(_moments(optimiser), temporary / "optimiser.safetensors")
    (temporary / "state.json").write_text(json.dumps(asdict(state), indent=1))
    for path in temporary.iterdir():
        _flush(path)
    shutil.rmtree(folder, ignore_errors=True)
    temporary.rename(folder)
    _flush(folder.parent)
    return folder


def load_checkpoint(
    folder: Path, model: nn.Module, optimiser: torch.optim.Optimizer | None = None
) -> CheckpointState:
    """Load a checkpoint into `model` (and `optimiser`) and return its metadata.

    Raises `TrainingError` when a file is damaged or of another version, before anything is filled in, and
    when the checkpoint does not fit the model.
    """
    try:
        state = CheckpointState(**json.loads((folder / "state.json").read_text()))
        tensors = load_file(folder / "model.safetensors")
        moments = load_file(folder / "optimiser.safetensors") if optimiser is not None else {}
    except (OSError, ValueError, TypeError, SafetensorError) as error:
        raise TrainingError(
            f"checkpoint {folder} cannot be read ({error}); delete it to start the stage again"
        ) from error
    if state.schema_version != SCHEMA_VERSION:
        raise TrainingError(
            f"checkpoint {folder} has version {state.schema_version}, this release reads {SCHEMA_VERSION}"
        )
    try:
        model.load_state_dict(tensors)
    except RuntimeError as error:
        raise TrainingError(f"checkpoint {folder} does not fit this configuration: {error}") from error
    if optimiser is not None:
        _restore_moments(optimiser, moments)
    return state


def latest_checkpoint(folder: Path) -> Path | None:
    """Return the checkpoint of the highest step below `folder`, or None."""
    states = [path for path in folder.glob("step_*/state.json") if path.parent.suffix == ""]
    return max((path.parent for path in states), key=lambda path: path.name, default=None)


def checkpoint_folder(folder: Path, step: int) -> Path:
    """Return the folder of the checkpoint of `step` below a stage's folder."""
    return folder / f"step_{step:07d}"


def prune_checkpoints(folder: Path, keep: int) -> None:
    """Remove all but the newest `keep` checkpoints below `folder`."""
    folders = sorted(path for path in folder.glob("step_*") if path.is_dir())
    for path in folders[: max(0, len(folders) - keep)]:
        shutil.rmtree(path)


def _moments(optimiser: torch.optim.Optimizer) -> dict[str, torch.Tensor]:
    values: dict[str, torch.Tensor] = {}
    for index, entry in optimiser.state_dict()["state"].items():
        for name, value in entry.items():
            values[f"{index}.{name}"] = torch.as_tensor(value).detach().cpu().contiguous()
    return values


def _restore_moments(optimiser: torch.optim.Optimizer, values: dict[str, torch.Tensor]) -> None:
    state: dict[int, dict[str, Any]] = {}
    for key, value in values.items():
        index, name = key.split(".")
        state.setdefault(int(index), {})[name] = value
    optimiser.load_state_dict({"state": state, "param_groups": optimiser.state_dict()["param_groups"]})


def _flush(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
