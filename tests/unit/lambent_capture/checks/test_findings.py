"""Findings about many pictures are put into few words."""

import pytest
from lambent_capture.checks.findings import note_findings
from lambent_capture.checks.limits import CaptureLimits
from lambent_capture.problems import Problems
from lambent_proto.v1 import capture_pb2


def clipped(num_views: int, num_lights: int) -> str:
    """Return what is said of a capture all of whose pictures are clipped."""
    views = [
        capture_pb2.ViewFigures(
            name=f"v{number}",
            moved_share=1.0,
            pictures=[
                capture_pb2.PictureFigures(light=str(light), path=f"{number}_{light}.png", clipped_share=0.5)
                for light in range(num_lights)
            ],
        )
        for number in range(num_views)
    ]
    problems = Problems()
    note_findings(capture_pb2.CaptureFigures(views=views), CaptureLimits(), problems, box_is_stated=True)
    (finding,) = (each for each in problems.findings() if "clipped" in each.code or "clipped" in each.message)
    return finding.message


@pytest.mark.parametrize(
    ("num_lights", "counted"),
    [
        (1, "40 views have this problem; the worst are"),
        (3, "40 views have this problem (120 pictures, because each light counts); the worst are"),
    ],
)
def test_a_finding_never_counts_more_views_than_there_are(num_lights: int, counted: str):
    message = clipped(40, num_lights)
    assert message.startswith(counted)
    named = message.partition("the worst are ")[2].partition(", the first")[0].split(", ")
    assert len(set(named)) == len(named) == CaptureLimits().max_named_views
