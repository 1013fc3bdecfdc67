"""Result of a capture check."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from lambent_proto.v1 import capture_pb2, scene_pb2


@dataclass(frozen=True, kw_only=True, slots=True)
class CaptureCheck:
    """Result of a capture check."""

    report: scene_pb2.SceneReport
    figures: capture_pb2.CaptureFigures | None = None
    """None where the capture cannot be used: then there is nothing to measure."""
    thumbnails: Mapping[str, str] = field(default_factory=dict)
    """JPEG in base64 by name of the frame."""
