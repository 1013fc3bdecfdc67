"""The order that a run process carries out."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from lambent_capture.checks.check_result import CaptureCheck
from lambent_core.reporter import Reporter
from lambent_proto.v1 import job_pb2, render_pb2, worker_pb2


@dataclass(frozen=True, kw_only=True, slots=True)
class Order:
    """A job with its folders, device and reporter."""

    spec: job_pb2.JobSpec
    scene_dir: Path
    run_dir: Path
    device: str
    adjustments: worker_pb2.Adjustments
    reporter: Reporter
    render: render_pb2.RenderTask = field(default_factory=render_pb2.RenderTask)
    """The pictures to make; empty for other kinds."""
    checked: CaptureCheck | None = None
    """Result of a check of the scene whose findings were reported already."""


Pipeline = Callable[[Order], Path | None]
"""Does the work and returns the folder of the bundle, or None where it makes none."""
Check = Callable[[Path], CaptureCheck]
