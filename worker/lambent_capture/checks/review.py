"""Measures a capture that is known to be usable and adds the resulting findings to its report."""

from collections.abc import Callable
from pathlib import Path

from lambent_proto.v1 import scene_pb2

from lambent_capture.checks.examine import Examination, examine_capture
from lambent_capture.checks.findings import note_findings
from lambent_capture.checks.limits import CaptureLimits
from lambent_capture.problems import MAX_FINDINGS, Problems

# Findings of the first check about single silhouettes are replaced or dropped after comparing all of them.
COARSE_CODES = frozenset({"scene.mask_disagrees"})


def review(
    folder: Path,
    manifest: scene_pb2.SceneManifest,
    report: scene_pb2.SceneReport,
    limits: CaptureLimits,
    announce: Callable[[str], None] = lambda path: None,
) -> Examination:
    """Return the measurements of the capture, after adding the findings to `report`.

    `announce` is called with the path of each file before it is decoded, and with "" once none is.
    """
    examination = examine_capture(folder, manifest, limits, announce)
    figures = examination.figures
    problems = Problems()
    note_findings(figures, limits, problems, box_is_stated=manifest.bounds_from != "cameras")
    known = {finding.code for finding in report.findings}
    kept = [finding for finding in report.findings if not (figures.has_hull and finding.code in COARSE_CODES)]
    fresh = [
        finding
        for finding in problems.findings()
        # The first check has established whether masks and poses agree at all.
        if finding.code != "scene.poses_inconsistent" or "scene.silhouettes_disagree" not in known
    ]
    del report.findings[:]
    report.findings.extend([*kept, *fresh][:MAX_FINDINGS])
    return examination
