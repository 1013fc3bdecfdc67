"""Cameras and masks that an earlier run found, brought into the folder of a new one.

A server keeps them with the scene and offers them to every run of it. Each says what it was made from:
cameras in `cameras/cameras.json`, masks in `estimated_masks/made_from.json`, and what corrections start from
in `estimated_masks/workspace/made_from.json`, which is the hash of the task `ingest`.
"""

import shutil
from collections.abc import Mapping
from pathlib import Path

from lambent_core.files import read_record, write_json

from lambent_run.run.folder import begun_inputs, task_folder

MADE_FROM = "made_from.json"
WORKSPACE = "workspace"
"""Folder of what corrections of masks start from, in that of the task `masks`."""


def note_made_from(folder: Path, inputs: str) -> None:
    """Write down what the files of a folder are made from, as the last of them."""
    write_json(folder / MADE_FROM, {"sha256": inputs})


def is_made_from(folder: Path, inputs: str) -> bool:
    """Return whether a folder says that it is complete and made from `inputs`."""
    return bool(inputs) and read_record(folder / MADE_FROM).get("sha256") == inputs


def drop_unfitting(run_dir: Path, hashes: Mapping[str, str]) -> None:
    """Remove cameras and masks that were brought into `run_dir` and were made from something else.

    `hashes` are those of the inputs of the run's tasks. What the run has begun itself is left to
    `begin_task`.
    """
    # Here, since whoever only looks at masks does not read captures.
    from lambent_capture.layouts.photographs import CAMERAS_FILE

    if begun_inputs(run_dir, "cameras") is None:
        cameras = task_folder(run_dir, "cameras")
        if read_record(cameras / CAMERAS_FILE).get("inputs") != hashes.get("cameras", ""):
            shutil.rmtree(cameras, ignore_errors=True)
    masks = task_folder(run_dir, "masks")
    if begun_inputs(run_dir, "masks") is not None or is_made_from(masks, hashes["masks"]):
        return
    workspace_fits = is_made_from(masks / WORKSPACE, hashes["ingest"])
    for path in masks.iterdir() if masks.is_dir() else ():
        if path.is_dir() and not (workspace_fits and path.name == WORKSPACE):
            shutil.rmtree(path)
        elif not path.is_dir():
            path.unlink()
