"""The interface through which the tasks of a run report."""

from pathlib import Path
from typing import Protocol

from lambent_proto.v1 import job_pb2


class Reporter(Protocol):
    """Listener of a run: a terminal, a server, or a test."""

    def progress(self, progress: job_pb2.Progress) -> None:
        """Tell how far the run is; what is unknown is 0."""

    def preview(self, name: str, png: bytes) -> None:
        """Show a small picture of the current state (at most 256 KiB)."""

    def checkpoint(self, stage: str, step: int, folder: Path) -> None:
        """Make the checkpoint in `folder` durable; returns when it is."""

    def artifact(self, name: str, path: Path) -> None:
        """Publish a file of the result under `name`."""

    def finding(self, code: str, message: str, *, subject: str = "", error: bool = False) -> None:
        """Tell the owner of the scene something about it, and what to do."""

    def log(self, event: str, **fields: object) -> None:
        """Write one line for operators: an event name and its fields."""

    def should_stop(self) -> bool:
        """Return whether the run was asked to end (cancelled, terminated, or fenced off)."""
