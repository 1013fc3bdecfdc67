"""Contexts of single tasks."""

from pathlib import Path
from typing import Any

from flashcache.config import Config
from lambent_run.run.context import TaskContext
from lambent_run.run.spec import RunSpec
from support.recording_reporter import RecordingReporter


def task_context(
    folder: Path, config: Config, task: str, stop_after: int | None = None, **spec: Any
) -> TaskContext:
    """Return the context of a task of a run in `folder`/run, whose folder exists."""
    made = TaskContext(
        spec=RunSpec(scene=folder / "scene", config=config, **spec),
        run_dir=folder / "run",
        device="cpu",
        reporter=RecordingReporter(stop_after),
        task=task,
    )
    made.folder.mkdir(parents=True, exist_ok=True)
    return made
