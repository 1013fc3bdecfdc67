"""What a pipeline step tells the outside world, whoever listens."""

from pathlib import Path
from typing import Protocol


class Reporter(Protocol):
    """Listener of a run: a terminal, a server, or a test."""

    def progress(
        self,
        *,
        stage: str,
        step: int,
        num_steps: int,
        fraction: float,
        eta_s: float,
        steps_per_s: float,
        loss: float,
        psnr: float,
    ) -> None:
        """Tell how far the run is; `fraction` of the whole job in 0..1, `psnr` in dB (0 if unknown)."""

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
