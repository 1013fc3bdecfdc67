"""The folder a run lives in: which of its tasks are done, and from what.

run.json                        the specification of the run; see `spec`
log.jsonl previews/             log and previews of the command line; a server keeps its own
known_lights/ masks/            copies of the user's files
cameras/ scene/ estimated_masks/ cache/ joint/ polish/ evaluation/
bundle/
                                results of the tasks, a folder each
tasks/<task>.inputs.json        hash of everything the task's files are made from, written before the first,
                                and the seconds it has taken
tasks/<task>.done.json          the same hash, written after the last
"""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from fcntl import LOCK_EX, LOCK_NB, flock
from pathlib import Path

from lambent_core.errors import UsageError, WorkerError
from lambent_core.files import read_record, write_json

TASK_FOLDERS = {
    "cameras": "cameras",
    "ingest": "scene",
    "masks": "estimated_masks",
    "cache": "cache",
    "joint": "joint",
    "polish": "polish",
    "evaluate": "evaluation",
    "export": "bundle",
    "bake": "bake",
}
LASTING = {"masks": frozenset({"workspace"})}
"""What says itself from which inputs it was made, by task: it outlives a change of the task's inputs."""


def task_folder(run_dir: Path, task: str) -> Path:
    """Return the folder that a task writes into."""
    return run_dir / TASK_FOLDERS[task]


def done_inputs(run_dir: Path, task: str) -> str | None:
    """Return the hash of the inputs that a task has finished with, or None where it has not."""
    return _read_hash(run_dir / "tasks" / f"{task}.done.json")


def begun_inputs(run_dir: Path, task: str) -> str | None:
    """Return the hash of the inputs that a task was begun with, or None where it never was."""
    return _read_hash(run_dir / "tasks" / f"{task}.inputs.json")


def require_done(run_dir: Path, task: str) -> str:
    """Return the hash of the inputs that a task has finished with; raises `UsageError` where it has not."""
    inputs = done_inputs(run_dir, task)
    if inputs is None:
        raise UsageError(
            "run.not_trained",
            f'the run in "{run_dir}" is not finished; run lambent train with --resume first',
        )
    return inputs


def begin_task(run_dir: Path, task: str, inputs: str) -> None:
    """Prepare a task's folder: remove what was made from other inputs, but for what is `LASTING`.

    A folder of unknown inputs is kept: that is how checkpoints look that were brought from elsewhere.
    """
    marker = run_dir / "tasks" / f"{task}.inputs.json"
    if _read_hash(marker) not in (None, inputs):
        _clear(task_folder(run_dir, task), LASTING.get(task, frozenset()))
        marker.unlink()
    task_folder(run_dir, task).mkdir(parents=True, exist_ok=True)
    marker.parent.mkdir(exist_ok=True)
    write_json(marker, {**read_record(marker), "sha256": inputs})


def _clear(folder: Path, kept: frozenset[str]) -> None:
    for path in folder.iterdir() if folder.is_dir() else ():
        if path.name in kept:
            continue
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)


def add_task_seconds(run_dir: Path, task: str, seconds: float) -> None:
    """Add the time of one sitting to the total of a task; a killed sitting does not count."""
    marker = run_dir / "tasks" / f"{task}.inputs.json"
    record = read_record(marker)
    write_json(marker, {**record, "seconds": round(record.get("seconds", 0.0) + seconds, 3)})


def finish_task(run_dir: Path, task: str, inputs: str) -> None:
    """Note that a task has finished."""
    write_json(run_dir / "tasks" / f"{task}.done.json", {"sha256": inputs})


def task_seconds(run_dir: Path) -> dict[str, float]:
    """Return the time in seconds that each task of a run has taken so far, over all sittings."""
    records = {task: read_record(run_dir / "tasks" / f"{task}.inputs.json") for task in TASK_FOLDERS}
    return {task: float(record["seconds"]) for task, record in records.items() if "seconds" in record}


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
