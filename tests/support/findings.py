"""Findings of reports, for tests."""

from pathlib import Path

from lambent_capture.loading.inspect import inspect_files
from lambent_proto.v1 import scene_pb2


def codes(
    report: scene_pb2.SceneReport, severity: scene_pb2.Severity = scene_pb2.SEVERITY_ERROR
) -> list[str]:
    """Return the codes of the errors, or of the findings of another severity."""
    return [finding.code for finding in report.findings if finding.severity == severity]


def warnings_of(report: scene_pb2.SceneReport) -> list[str]:
    """Return the codes of the warnings."""
    return codes(report, scene_pb2.SEVERITY_WARNING)


def subject_of(report: scene_pb2.SceneReport, code: str) -> str:
    """Return what the first finding with a code is about."""
    return next(finding.subject for finding in report.findings if finding.code == code)


def only(folder: Path) -> scene_pb2.Finding:
    """Return the only finding about the capture in a folder, which is usable if that is a warning."""
    report = inspect_files(folder).report
    assert len(report.findings) == 1, [f"{f.code}: {f.message}" for f in report.findings]
    (finding,) = report.findings
    assert report.usable == (finding.severity == scene_pb2.SEVERITY_WARNING)
    return finding
