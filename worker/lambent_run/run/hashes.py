"""Hashes of everything that a task's result depends on."""

from pathlib import Path
from typing import TYPE_CHECKING

from lambent_core.files import digest, file_sha256

from lambent_run.run.preparation import cameras_hash, files_hash, ingest_hash
from lambent_run.run.spec import RunSpec, card_text, corrections_hash

if TYPE_CHECKING:
    from flashcache.config import Config

TASKS = ("cameras", "ingest", "masks", "cache", "joint", "polish", "evaluate", "export")
"""In order. Only photographs without cameras have `cameras`, and `polish` is left out where it is off."""
PREPARATION = ("cameras", "ingest", "masks")
"""What comes before the training."""

# What a training task's files depend on: the task before it, and the parts of the configuration it reads.
# Masks that are estimated depend on nothing but what `ingest` depends on, and on a person's corrections.
# `evaluate` and `export` depend on the last task that changes the model: `last_training_task`.
PREVIOUS = {"cache": "ingest", "joint": "cache", "polish": "joint"}
CONFIG_PARTS = {
    "cache": ("max_side", "crop", "space", "model", "pixels", "stage_one"),
    "joint": ("stage_two",),
    "polish": ("polish",),
    "evaluate": ("evaluation",),
    "export": ("export",),
}


def input_hashes(spec: RunSpec) -> dict[str, str]:
    """Return for every task of the run the hash of everything its result depends on.

    A run without settings of the method has the tasks of `PREPARATION` only.
    """
    scene = scene_hash(spec.scene)
    hashes = {}
    if spec.lacks_cameras:
        hashes["cameras"] = cameras_hash(scene, spec.seed)
    hashes["ingest"] = ingest_hash(
        scene,
        lights=spec.lights,
        layout=spec.layout,
        known_lights=spec.known_lights,
        masks=spec.masks,
        cameras=hashes.get("cameras"),
        light_fixed_to=spec.light_fixed_to,
    )
    corrected = corrections_hash(spec)
    hashes["masks"] = digest("masks", hashes["ingest"], *([corrected] if corrected else []))
    if spec.config is None:
        return hashes
    trained = last_training_task(spec.config)
    for name in CONFIG_PARTS:
        if name == "polish" and name != trained:
            continue
        previous = "masks" if corrected and name == "cache" else PREVIOUS.get(name, trained)
        hashes[name] = task_inputs(name, hashes[previous], spec.config, spec.seed)
        if name == "polish" and spec.grey_card is not None:
            hashes[name] = digest(hashes[name], card_text(spec))
    return hashes


def last_training_task(config: "Config | None") -> str:
    """Return the last task of a run that changes the model, also of one that is only prepared so far."""
    return "polish" if config is not None and config.polish == "on" else "joint"


def cameras_inputs(scene_dir: Path, spec: RunSpec) -> str:
    """Return the hash of what the cameras of the photographs in `scene_dir` are found from, in a run."""
    return cameras_hash(scene_hash(scene_dir), spec.seed)


def task_inputs(task: str, previous: str, config: "Config", seed: int) -> str:
    """Return the hash of what a task depends on, given that of the task before it."""
    from flashcache.config import to_dict

    values = to_dict(config)
    return digest(task, previous, seed, {part: values[part] for part in CONFIG_PARTS[task]})


def scene_hash(scene_dir: Path) -> str:
    """Return a hash of the names and contents of all files of a capture.

    Files whose names begin with a dot do not count, and times do not, so that a copy of the capture on
    another machine is the same capture.
    """
    files = (path for path in scene_dir.rglob("*") if path.is_file() and not path.name.startswith("."))
    return files_hash((path.relative_to(scene_dir).as_posix(), file_sha256(path)) for path in files)
