"""A reporter that records its calls."""

from pathlib import Path
from typing import Any

from lambent_proto.v1.job_pb2 import Progress


class RecordingReporter:
    """Keeps every call in `calls`; asks to stop after `stop_after` progress calls."""

    def __init__(self, stop_after: int | None = None) -> None:
        self.calls: list[tuple[str, dict[str, Any]]] = []
        self._stop_after = stop_after

    def named(self, name: str) -> list[dict[str, Any]]:
        """Return the arguments of all calls of one kind."""
        return [fields for kind, fields in self.calls if kind == name]

    def progress(self, progress: Progress) -> None:
        fields = {item.name: getattr(progress, item.name) for item in progress.DESCRIPTOR.fields}
        self.calls.append(("progress", fields))

    def preview(self, name: str, png: bytes) -> None:
        self.calls.append(("preview", {"name": name, "png": png}))

    def checkpoint(self, stage: str, step: int, folder: Path) -> None:
        self.calls.append(("checkpoint", {"stage": stage, "step": step, "folder": folder}))

    def artifact(self, name: str, path: Path) -> None:
        self.calls.append(("artifact", {"name": name, "path": path}))

    def finding(self, code: str, message: str, *, subject: str = "", error: bool = False) -> None:
        self.calls.append(("finding", {"code": code, "message": message, "subject": subject, "error": error}))

    def log(self, event: str, **fields: object) -> None:
        self.calls.append((event, fields))

    def should_stop(self) -> bool:
        return self._stop_after is not None and len(self.named("progress")) >= self._stop_after
