"""Builds the report page of a capture: findings, thumbnails, the sphere of views."""

from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined
from lambent_core.files import write_json
from lambent_core.measured import measured
from lambent_proto.v1 import capture_pb2, scene_pb2

from lambent_capture.checks.check_result import CaptureCheck, capture_record
from lambent_capture.checks.limits import CaptureLimits
from lambent_capture.checks.plot import plot_views


def build_page(name: str, checked: CaptureCheck, limits: CaptureLimits) -> str:
    """Return a self-contained page: no script, no style sheet, no picture file.

    Everything that came with the capture, such as names of frames, is escaped.
    """
    report, thumbnails = checked.report, checked.thumbnails
    figures = checked.figures or capture_pb2.CaptureFigures()
    complaints = _by_view(report, figures)
    cards = [
        {
            "view": view,
            "jpeg": thumbnails.get(view.name, ""),
            "split": "training" if view.split == scene_pb2.SPLIT_TRAIN else "test",
            "figures": _figures(view, figures, limits),
            "codes": sorted(complaints.get(view.name, set())),
        }
        for view in sorted(figures.views, key=lambda view: -len(complaints.get(view.name, set())))
    ]
    environment = Environment(
        loader=PackageLoader("lambent_capture.checks", "."), autoescape=True, undefined=StrictUndefined
    )
    environment.filters["measured"] = measured
    return environment.get_template("page.html.j2").render(
        name=name,
        report=report,
        figures=figures,
        error=scene_pb2.SEVERITY_ERROR,
        cards=cards,
        plot=plot_views(figures, flagged={view for view, codes in complaints.items() if codes}),
    )


def write_capture_report(folder: Path, name: str, checked: CaptureCheck) -> None:
    """Write `capture.html` and `capture.json` into `folder`, made if it does not exist."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "capture.html").write_text(build_page(name, checked, CaptureLimits()), encoding="utf-8")
    write_json(folder / "capture.json", capture_record(checked))


def _by_view(report: scene_pb2.SceneReport, figures: capture_pb2.CaptureFigures) -> dict[str, set[str]]:
    """Return the codes of the findings about each view, whether they name the frame or its file."""
    owner = {view.name: view.name for view in figures.views}
    owner |= {picture.path: view.name for view in figures.views for picture in view.pictures}
    codes: dict[str, set[str]] = {}
    for finding in report.findings:
        if finding.subject in owner:
            codes.setdefault(owner[finding.subject], set()).add(finding.code)
    return codes


def _figures(
    view: capture_pb2.ViewFigures, figures: capture_pb2.CaptureFigures, limits: CaptureLimits
) -> list[tuple[str, str, bool]]:
    """Return label and text of the numbers under a thumbnail, and whether they are over their limits."""
    clipped = max((picture.clipped_share for picture in view.pictures), default=0.0)
    sharpness = min((picture.sharpness for picture in view.pictures if picture.sharpness), default=0.0)
    jump = max((picture.exposure_jump_ev for picture in view.pictures), key=abs, default=0.0)
    rows = [
        ("sharpness", f"{measured(sharpness, 2)}", 0.0 < sharpness < limits.sharpness),
        ("clipped", f"{measured(100.0 * clipped, 1)} %", clipped > limits.clipped_share),
    ]
    if figures.has_hull:
        rows += [
            ("exposure", f"{measured(jump, 2, signed=True)} EV", abs(jump) > limits.exposure_ev),
            (
                "unexplained",
                f"{measured(100.0 * view.unexplained_share, 1)} %",
                view.unexplained_share > limits.unexplained_share,
            ),
            (
                "cut away",
                f"{measured(100.0 * max(view.carved_share, view.hole_share), 1)} %",
                max(view.carved_share, view.hole_share) > limits.missing_share,
            ),
        ]
    return rows
