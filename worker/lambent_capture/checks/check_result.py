"""Result of a capture check."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from lambent_core.messages import message_to_dict
from lambent_core.reporter import Reporter
from lambent_proto.v1 import capture_pb2, scene_pb2


@dataclass(frozen=True, kw_only=True, slots=True)
class CaptureCheck:
    """Result of a capture check."""

    report: scene_pb2.SceneReport
    figures: capture_pb2.CaptureFigures | None = None
    """None where the capture cannot be used: then there is nothing to measure."""
    thumbnails: Mapping[str, str] = field(default_factory=dict)
    """JPEG in base64 by name of the frame."""
    portrait: str = ""
    """The first picture, by which people recognise the capture: JPEG in base64; empty where there is none."""
    left_out: tuple[str, ...] = ()
    """Pictures that cannot be decoded, few enough to do without; for `describe_scene`."""


def capture_record(checked: CaptureCheck) -> dict[str, Any]:
    """Return the report on a capture as JSON, its figures under "figures" (null where there are none)."""
    figures = None if checked.figures is None else message_to_dict(checked.figures)
    return {**message_to_dict(checked.report), "figures": figures}


def tell_findings(reporter: Reporter, findings: Iterable[scene_pb2.Finding]) -> None:
    """Tell the owner of a capture what was found."""
    for finding in findings:
        error = finding.severity == scene_pb2.SEVERITY_ERROR
        reporter.finding(finding.code, finding.message, subject=finding.subject, error=error)
