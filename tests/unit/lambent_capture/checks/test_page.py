"""The page about a capture: whole without network and scripts, safe to show whatever a frame is called."""

import json
import xml.etree.ElementTree as ElementTree

import pytest
from lambent_capture.checks.check_result import CaptureCheck
from lambent_capture.checks.limits import CaptureLimits
from lambent_capture.checks.page import build_page, write_capture_report
from lambent_capture.checks.plot import on_disc, plot_views
from lambent_proto.v1 import capture_pb2, scene_pb2

HOSTILE = '"><script>alert(1)</script>'


def view(name: str, **fields) -> capture_pb2.ViewFigures:
    pictures = [capture_pb2.PictureFigures(path=f"{name}.png", sharpness=0.4, clipped_share=0.2)]
    return capture_pb2.ViewFigures(name=name, split="SPLIT_TRAIN", pictures=pictures, **fields)


def checked(*names: str) -> CaptureCheck:
    findings = [
        scene_pb2.Finding(
            code="scene.image_blurred",
            severity="SEVERITY_WARNING",
            message=f"soft {name}",
            subject=f"{name}.png",
        )
        for name in names[:1]
    ]
    figures = capture_pb2.CaptureFigures(
        has_masks=True,
        has_hull=True,
        upper_gap_deg=60.0,
        views=[view(name, elevation_deg=30.0) for name in names],
    )
    report = scene_pb2.SceneReport(usable=True, layout="nerf_blender", findings=findings, num_train_frames=2)
    return CaptureCheck(report=report, figures=figures, thumbnails=dict.fromkeys(names, "QUJD"))


def page_of(check: CaptureCheck) -> str:
    return build_page("mug & saucer", check, CaptureLimits())


def test_the_page_shows_findings_figures_and_thumbnails():
    page = page_of(checked("r_1", "r_0"))
    assert "mug &amp; saucer" in page
    assert "soft r_1" in page
    assert page.count('src="data:image/jpeg;base64,QUJD"') == 2
    assert page.count('class="flagged"') == 1
    assert page.index('alt="r_1"') < page.index('alt="r_0"'), "views with findings come first"
    assert '<dd class="bad">0.40</dd>' in page


def test_the_page_needs_nothing_from_elsewhere():
    page = page_of(checked("r_0"))
    assert "<script" not in page
    assert "http" not in page.replace("http://www.w3.org/2000/svg", "")
    assert "<link" not in page


def test_names_from_a_capture_are_escaped_everywhere():
    page = page_of(checked(HOSTILE))
    assert "<script" not in page
    assert page.count("&lt;script&gt;") >= 4


def test_a_capture_that_cannot_be_used_has_a_page_without_views():
    report = scene_pb2.SceneReport(findings=[scene_pb2.Finding(code="scene.x", severity="SEVERITY_ERROR")])
    page = page_of(CaptureCheck(report=report))
    assert '<li class="bad"><code>scene.x</code>' in page
    assert "<svg" not in page


def test_the_plot_is_well_formed_with_a_dot_for_each_view():
    figures = checked("r_0", HOSTILE).figures
    root = ElementTree.fromstring(plot_views(figures, flagged={"r_0"}))  # noqa: S314 (made by us)
    space = "{http://www.w3.org/2000/svg}"
    dots = [each for each in root.iter(f"{space}circle") if each.find(f"{space}title") is not None]
    assert [each.find(f"{space}title").text for each in dots] == ["r_0", HOSTILE]
    assert [each.get("class") for each in dots] == ["train bad", "train"]
    assert len(list(root.iter(f"{space}polygon"))) == 1


def test_views_below_the_horizon_have_a_disc_of_their_own():
    figures = capture_pb2.CaptureFigures(
        views=[view("low", elevation_deg=-20.0), view("high", elevation_deg=20.0)]
    )
    svg = plot_views(figures, flagged=set())
    assert svg.index("high") < svg.index("from below") < svg.index("low")


def test_the_zenith_is_the_middle_of_the_disc_and_the_horizon_its_rim():
    assert on_disc(0.0, 90.0) == pytest.approx((0.0, 0.0))
    x, y = on_disc(90.0, 0.0)
    assert x == pytest.approx(0.0)
    assert y < 0.0, "+y of the world is up on the page"


def test_the_report_is_written_into_a_new_folder(tmp_path):
    checked = CaptureCheck(report=scene_pb2.SceneReport(usable=False, layout="colmap"))
    write_capture_report(tmp_path / "a" / "b", "bowl <1>", checked)
    assert "bowl &lt;1&gt;" in (tmp_path / "a" / "b" / "capture.html").read_text()
    record = json.loads((tmp_path / "a" / "b" / "capture.json").read_text())
    assert (record["layout"], record["usable"], record["figures"]) == ("colmap", False, None)
