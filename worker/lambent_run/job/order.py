"""The order that a run process carries out."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from lambent_capture.checks.check_result import CaptureCheck
from lambent_core.reporter import Reporter
from lambent_proto.v1 import worker_pb2

from lambent_run.run.parameters import JobParameters


@dataclass(frozen=True, kw_only=True, slots=True)
class Order:
    """The server's order, with the folders on this machine and the reporter."""

    start: worker_pb2.StartResponse
    scene_dir: Path
    run_dir: Path
    reporter: Reporter
    parameters: JobParameters = field(default_factory=JobParameters)
    """Of the kinds `train` and `prepare`."""
    checked: CaptureCheck | None = None
    """Result of a check of the scene whose findings were reported already."""


Pipeline = Callable[[Order], Path | None]
"""Does the work and returns the folder of the bundle, or None where it makes none."""
Check = Callable[[Path], CaptureCheck]
