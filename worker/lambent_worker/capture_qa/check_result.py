"""Result of a capture check."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from lambent_proto.v1 import capture_pb2, scene_pb2

from lambent_worker.reporter import Reporter


@dataclass(frozen=True, kw_only=True, slots=True)
class CaptureCheck:
    """Result of a capture check."""

    report: scene_pb2.SceneReport
    figures: capture_pb2.CaptureFigures | None = None
    """None where the capture cannot be used: then there is nothing to measure."""
    thumbnails: Mapping[str, str] = field(default_factory=dict)
    """JPEG in base64 by name of the frame."""
    left_out: tuple[str, ...] = ()
    """Pictures that cannot be decoded, few enough to do without; for `describe_scene`."""


def tell_findings(reporter: Reporter, findings: Iterable[scene_pb2.Finding]) -> None:
    """Tell the owner of a capture what was found."""
    for finding in findings:
        error = finding.severity == scene_pb2.SEVERITY_ERROR
        reporter.finding(finding.code, finding.message, subject=finding.subject, error=error)
