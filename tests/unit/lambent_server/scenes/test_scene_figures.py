"""Figures measured on a scene: stored by its run, shown as JSON or as a page, gone with the scene."""

from collections.abc import Iterator

import grpc
import pytest
from lambent_core.layouts import LAYOUTS
from lambent_proto.v1 import capture_pb2
from lambent_server.database.schema import garbage
from lambent_server.database.tenancy import across_tenants
from lambent_server.scenes.routes import prefers_html
from support.api import STRANGER_KEY, expect, expect_problem
from support.runs import Stage, refused, staged

PAGE = b"<!doctype html><title>a scene</title>"
REPORT = {"usable": True, "layout": "nerf_blender", "num_train_frames": 3}
FIGURES = capture_pb2.CaptureFigures(
    schema_version="1.0",
    num_train_views=3,
    upper_gap_deg=61.5,
    views=[
        capture_pb2.ViewFigures(
            name="r_0",
            split="SPLIT_TRAIN",
            pictures=[capture_pb2.PictureFigures(path="r_0.png", sharpness=0.9)],
        )
    ],
)


@pytest.fixture(scope="module")
def stage(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stage]:
    with staged(tmp_path_factory.mktemp("s")) as stage:
        yield stage


@pytest.fixture
def job(stage: Stage) -> Iterator[str]:
    """Return a job that looks at a scene of its own; it is over at the end of the test."""
    job = stage.start(kind="check")
    yield job
    stage.call("Finish", job, outcome="OUTCOME_SUCCEEDED")
    stage.end(0)


@pytest.fixture
def scene_id(stage: Stage, job: str) -> str:
    """Return the job's scene, measured."""
    stage.call("ReportScene", job, report=REPORT, figures=FIGURES, page_sha256=stage.put(job, PAGE))
    return str(stage.job(job)["scene_id"])


def test_figures_come_back_with_the_report(stage: Stage, scene_id: str):
    report = expect(stage.api.get(f"/v1/scenes/{scene_id}/report"), 200)
    assert report["usable"] is True
    assert report["layout_title"] == LAYOUTS[report["layout"]].title
    assert report["figures"]["upper_gap_deg"] == 61.5
    (view,) = report["figures"]["views"]
    assert (view["name"], view["split"], view["pictures"][0]["sharpness"]) == ("r_0", "train", 0.9)


def test_a_scene_that_nobody_has_measured_has_no_figures_and_no_page(stage: Stage):
    scene_id = stage.api.scene()
    assert expect(stage.api.get(f"/v1/scenes/{scene_id}/report"), 200)["figures"] is None
    answer = stage.api.get(f"/v1/scenes/{scene_id}/report", params={"format": "html"})
    expect_problem(answer, 404, "report_page_not_found")


def test_the_page_is_shown_where_it_is_asked_for_and_may_run_nothing(stage: Stage, scene_id: str):
    path = f"/v1/scenes/{scene_id}/report"
    browser = "text/html,application/xhtml+xml,application/xml;q=0.9,*/*;q=0.8"
    for answer in (
        stage.api.get(path, params={"format": "html"}),
        stage.api.get(path, headers={"accept": browser}),
    ):
        assert (answer.status_code, answer.content) == (200, PAGE)
        assert answer.headers["content-type"] == "text/html; charset=utf-8"
        assert "sandbox" in answer.headers["content-security-policy"]
        assert "script-src" not in answer.headers["content-security-policy"]
    answer = stage.api.get(path, params={"format": "json"}, headers={"accept": browser})
    assert answer.headers["content-type"] == "application/json"


@pytest.mark.parametrize(
    ("accept", "html"),
    [
        ("", False),
        ("*/*", False),
        ("application/json", False),
        ("text/html", True),
        ("text/html,application/json", False),
        ("text/html;q=0.5,application/json;q=0.4", True),
        ("text/html;q=0,application/json;q=0", False),
        ("text/html;q=nonsense", False),
        ("Text/HTML , */* ; q=0.1", True),
    ],
)
def test_an_accept_header_is_read_as_it_is_meant(accept: str, html: bool):
    assert prefers_html(accept) is html


def test_a_page_must_have_been_sent_before(stage: Stage, job: str):
    with refused(grpc.StatusCode.INVALID_ARGUMENT):
        stage.call("ReportScene", job, report=REPORT, figures=FIGURES, page_sha256="0" * 64)


def test_figures_that_json_cannot_hold_are_refused(stage: Stage, job: str):
    broken = capture_pb2.CaptureFigures(gap_deg=float("nan"))
    with refused(grpc.StatusCode.INVALID_ARGUMENT):
        stage.call("ReportScene", job, report=REPORT, figures=broken)


def test_the_next_look_replaces_the_figures_and_lets_go_of_the_page(stage: Stage, job: str, scene_id: str):
    page = stage.put(job, b"another page")
    stage.call("ReportScene", job, report=REPORT, figures=FIGURES, page_sha256=page)
    assert not is_discarded(stage, page)
    stage.call("ReportScene", job, report={"usable": False})
    assert expect(stage.api.get(f"/v1/scenes/{scene_id}/report"), 200)["figures"] is None
    assert is_discarded(stage, page)


def test_a_scene_that_is_deleted_takes_its_page_along(stage: Stage):
    job = stage.start(kind="check")
    page = stage.put(job, b"a page of its own")
    stage.call("ReportScene", job, report=REPORT, figures=FIGURES, page_sha256=page)
    stage.call("Finish", job, outcome="OUTCOME_SUCCEEDED")
    stage.end(0)
    expect(stage.api.delete(f"/v1/scenes/{stage.job(job)['scene_id']}"), 204)
    assert is_discarded(stage, page)


def test_strangers_see_neither_figures_nor_page(stage: Stage, scene_id: str):
    for form in ("json", "html"):
        answer = stage.api.other(STRANGER_KEY).get(f"/v1/scenes/{scene_id}/report", params={"format": form})
        expect_problem(answer, 404, "scene_not_found")


def is_discarded(stage: Stage, digest: str) -> bool:
    with stage.api.services.database.read() as connection:
        found = connection.execute(across_tenants(garbage).where(garbage.c.sha256 == digest)).all()
    return len(found) == 1
