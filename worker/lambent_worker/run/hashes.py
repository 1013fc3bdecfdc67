"""Hashes of everything that a step's result depends on."""

from collections.abc import Mapping
from pathlib import Path

from flashcache.config import Config, to_dict

from lambent_worker.files import digest, file_sha256

STEPS = ("ingest", "cache", "joint", "evaluate", "export")

# What a step's files depend on: the step before it, and the parts of the configuration it reads.
PREVIOUS = {"cache": "ingest", "joint": "cache", "evaluate": "joint", "export": "joint"}
CONFIG_PARTS = {
    "cache": ("max_side", "space", "model", "pixels", "stage_one"),
    "joint": ("stage_two",),
    "evaluate": ("evaluation",),
    "export": ("export",),
}


def input_hashes(
    scene_dir: Path,
    config: Config,
    seed: int,
    lights: tuple[str, ...],
    layout: str,
    known_lights: Mapping[str, str] | None = None,
    masks: str = "",
) -> dict[str, str]:
    """Return for every step the hash of everything its result depends on."""
    given: list[object] = [dict(known_lights)] if known_lights else []
    given += [{"masks": masks}] if masks else []
    hashes = {"ingest": digest("ingest", scene_hash(scene_dir), list(lights), layout, *given)}
    for name in STEPS[1:]:
        hashes[name] = step_inputs(name, hashes[PREVIOUS[name]], config, seed)
    return hashes


def step_inputs(step: str, previous: str, config: Config, seed: int) -> str:
    """Return the hash of what a step depends on, given that of the step before it."""
    values = to_dict(config)
    return digest(step, previous, seed, {part: values[part] for part in CONFIG_PARTS[step]})


def scene_hash(scene_dir: Path) -> str:
    """Return a hash of the names and contents of all files of a capture.

    Files whose names begin with a dot do not count, and times do not, so that a copy of the capture on
    another machine is the same capture.
    """
    files = sorted(path for path in scene_dir.rglob("*") if path.is_file() and not path.name.startswith("."))
    names = [path.relative_to(scene_dir).as_posix() for path in files]
    return digest([[name, file_sha256(path)] for name, path in zip(names, files, strict=True)])
