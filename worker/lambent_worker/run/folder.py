"""The folder a run lives in: what it was asked to do, and which of its steps are done.

run.json                    settings, scene, versions
scene/ cache/ joint/ evaluation/ bundle/ previews/
<step folder>/inputs.json   hash of everything the step's files were made from, written before the first
<step folder>/done.json     the same hash, written after the last
"""

import json
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from fcntl import LOCK_EX, LOCK_NB, flock
from importlib.metadata import version
from pathlib import Path
from typing import Any

from lambent_worker.errors import UsageError, WorkerError
from lambent_worker.files import read_record, write_json

SCHEMA_VERSION = "1.0"
STEP_FOLDERS = {
    "ingest": "scene",
    "cache": "cache",
    "joint": "joint",
    "evaluate": "evaluation",
    "export": "bundle",
    "bake": "bake",
}


@dataclass(frozen=True, kw_only=True, slots=True)
class RunSettings:
    """What a run was asked to do."""

    preset: str
    config: Mapping[str, Any]
    """The whole configuration, as `flashcache.config.to_dict` returns it."""
    seed: int = 0
    device: str = field(compare=False, default="cpu")
    """May change between two starts, as `scene` may."""
    lights: tuple[str, ...] = ()
    """Training lights by name; empty for the scene's first."""
    layout: str = ""
    """Layout to read the scene as; empty to detect it."""
    known_lights: Mapping[str, str] = field(default_factory=dict)
    """Names of the kept files of given environments by light; see `known_lights`."""
    masks: str = ""
    """Where masks come from: the capture or an estimate (""), nowhere ("none"), or given ones by content."""
    scene: str = field(compare=False, default="")
    """Folder of the capture."""


def write_settings(run_dir: Path, settings: RunSettings) -> None:
    """Write `run.json`."""
    run_dir.mkdir(parents=True, exist_ok=True)
    record = {
        "schema_version": SCHEMA_VERSION,
        **asdict(settings),
        "lights": list(settings.lights),
        "created_at": datetime.now(UTC).isoformat(timespec="seconds"),
        "versions": {name: version(name) for name in ("lambent", "torch", "numpy")},
    }
    write_json(run_dir / "run.json", record)


def read_settings(run_dir: Path) -> RunSettings:
    """Return what is in `run.json`; raises `UsageError` where the folder holds no run."""
    try:
        record = json.loads((run_dir / "run.json").read_text(encoding="utf-8"))
        major = record["schema_version"].split(".")[0]
        settings = RunSettings(
            preset=record["preset"],
            config=record["config"],
            seed=record["seed"],
            device=record["device"],
            lights=tuple(record["lights"]),
            layout=record["layout"],
            known_lights=record.get("known_lights", {}),
            masks=record.get("masks", ""),
            scene=record["scene"],
        )
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise UsageError(
            "run.not_found", f'"{run_dir}" holds no readable run.json; give a folder made by lambent train'
        ) from error
    if major != SCHEMA_VERSION.split(".")[0]:
        raise UsageError(
            "run.version", f'"{run_dir}" was written by another version; train again with this one'
        )
    return settings


def step_folder(run_dir: Path, step: str) -> Path:
    """Return the folder that a step writes into."""
    return run_dir / STEP_FOLDERS[step]


def done_inputs(run_dir: Path, step: str) -> str | None:
    """Return the hash of the inputs that a step has finished with, or None where it has not."""
    return _read_hash(run_dir / "steps" / f"{step}.done.json")


def begin_step(run_dir: Path, step: str, inputs: str) -> None:
    """Prepare a step's folder: remove what was made from other inputs.

    A folder of unknown inputs is kept: that is how checkpoints look that were brought from elsewhere.
    """
    marker = run_dir / "steps" / f"{step}.inputs.json"
    if _read_hash(marker) not in (None, inputs):
        shutil.rmtree(step_folder(run_dir, step), ignore_errors=True)
        marker.unlink()
    step_folder(run_dir, step).mkdir(parents=True, exist_ok=True)
    marker.parent.mkdir(exist_ok=True)
    write_json(marker, {**read_record(marker), "sha256": inputs})


def add_step_seconds(run_dir: Path, step: str, seconds: float) -> None:
    """Add the time of one sitting to what a step has taken; a killed sitting does not count."""
    marker = run_dir / "steps" / f"{step}.inputs.json"
    record = read_record(marker)
    write_json(marker, {**record, "seconds": round(record.get("seconds", 0.0) + seconds, 3)})


def finish_step(run_dir: Path, step: str, inputs: str) -> None:
    """Note that a step has finished."""
    write_json(run_dir / "steps" / f"{step}.done.json", {"sha256": inputs})


def stage_seconds(run_dir: Path) -> dict[str, float]:
    """Return the time in seconds that each step of a run has taken so far, over all sittings."""
    found = {step: read_record(run_dir / "steps" / f"{step}.inputs.json") for step in STEP_FOLDERS}
    return {step: float(record["seconds"]) for step, record in found.items() if "seconds" in record}


def _read_hash(path: Path) -> str | None:
    return read_record(path).get("sha256")


@contextmanager
def locked(run_dir: Path) -> Iterator[None]:
    """Hold the run folder for this process; raises `WorkerError` where another process works in it."""
    run_dir.mkdir(parents=True, exist_ok=True)
    with (run_dir / ".lock").open("w") as file:
        try:
            flock(file, LOCK_EX | LOCK_NB)
        except OSError as error:
            raise WorkerError(
                "run.busy", f'another process works in "{run_dir}"; wait for it or choose another folder'
            ) from error
        yield
