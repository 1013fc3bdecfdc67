"""Pictures by which scenes, jobs and bundles are recognised: where they come from and when they go."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import grpc
import pytest
from lambent_server.database.schema import garbage
from lambent_server.database.tenancy import across_tenants
from lambent_server.jobs.queries import require_job
from lambent_server.jobs.rows import set_fields
from lambent_server.maintenance.housekeeping import sweep
from support.api import TENANT, expect, sha256
from support.runs import Stage, refused, staged
from support.server_rows import add_bundle

REPORT = {"usable": True, "layout": "nerf_blender", "num_train_frames": 3}


@pytest.fixture(scope="module")
def stage(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stage]:
    with staged(tmp_path_factory.mktemp("s"), garbage_after_s=0.001) as stage:
        yield stage


def scene_of(stage: Stage, job: str) -> dict[str, Any]:
    return expect(stage.api.get(f"/v1/scenes/{stage.job(job)['scene_id']}"), 200)


def preview(stage: Stage, job: str, data: bytes, sequence: int, name: str = "a") -> str:
    """Report a preview and return its hash."""
    digest = stage.put(job, data)
    stage.call("Report", job, sequence=sequence, events=[{"type": "preview", "name": name, "sha256": digest}])
    return digest


def is_discarded(stage: Stage, digest: str) -> bool:
    with stage.api.services.database.read() as connection:
        return (
            connection.execute(across_tenants(garbage).where(garbage.c.sha256 == digest)).first() is not None
        )


def test_a_scene_shows_the_photograph_of_its_last_check_until_it_is_deleted(stage: Stage):
    job = stage.start(kind="check")
    assert scene_of(stage, job)["thumbnail_url"] is None
    with refused(grpc.StatusCode.INVALID_ARGUMENT):
        stage.call("ReportScene", job, report=REPORT, thumbnail_sha256="0" * 64)
    first, second = stage.put(job, b"first photograph"), stage.put(job, b"second photograph")
    stage.call("ReportScene", job, report=REPORT, thumbnail_sha256=first)
    assert scene_of(stage, job)["thumbnail_url"] == f"/v1/blobs/{first}"
    # Waits for its first preview, and until then is known by its scene.
    assert stage.job(job)["thumbnail_url"] == f"/v1/blobs/{first}"
    stage.call("ReportScene", job, report=REPORT, thumbnail_sha256=second)
    assert is_discarded(stage, first)
    sweep(stage.api.services)
    shown = scene_of(stage, job)
    assert stage.api.get(shown["thumbnail_url"]).content == b"second photograph"
    stage.call("ReportScene", job, report=REPORT)
    assert scene_of(stage, job)["thumbnail_url"] == f"/v1/blobs/{second}"
    (listed,) = (each for each in stage.api.get("/v1/scenes").json()["items"] if each["id"] == shown["id"])
    assert listed == shown
    stage.call("Finish", job, outcome="OUTCOME_SUCCEEDED")
    stage.end(0)
    expect(stage.api.delete(f"/v1/scenes/{shown['id']}"), 204)
    assert is_discarded(stage, second)
    gone = stage.job(job)
    assert (gone["thumbnail_url"], gone["scene_name"]) == (None, "")


def test_a_job_shows_the_picture_of_its_bundle_and_never_the_sheet_of_its_evaluation(
    stage: Stage, tmp_path: Path
):
    job = stage.start()
    turning = preview(stage, job, b"turning", 1, "turning_joint")
    sheet = preview(stage, job, b"sheet", 2, "evaluation")
    assert sheet != turning
    assert stage.job(job)["thumbnail_url"] == f"/v1/blobs/{turning}"
    bundle = add_bundle(stage.api, tmp_path, {"thumbnail.webp": b"picture"}, bundle_id="bundle_of_a_job")
    bare = add_bundle(stage.api, tmp_path, {"manifest.json": b"{}"}, bundle_id="bundle_without_pictures")
    for bundle_id, shown in (
        (bundle, f"/v1/bundles/{bundle}/files/thumbnail.webp"),
        (bare, f"/v1/blobs/{turning}"),
        ("bundle_that_was_deleted", f"/v1/blobs/{turning}"),
    ):
        with stage.api.services.database.write() as connection:
            row = require_job(connection, TENANT, job)
            set_fields(connection, row, bundle_id=bundle_id)
        (listed,) = (each for each in stage.api.get("/v1/jobs").json()["items"] if each["id"] == job)
        assert stage.job(job)["thumbnail_url"] == listed["thumbnail_url"] == shown
        assert stage.api.get(shown).status_code == 200
    stage.call("Fail", job, cause="FAIL_CAUSE_BAD_SCENE", code="x", message="x")
    stage.end(0)


def test_a_job_shows_its_newest_preview_and_the_name_of_its_scene(stage: Stage):
    job = stage.start()
    assert stage.job(job)["thumbnail_url"] is None
    preview(stage, job, b"early", 1)
    late = preview(stage, job, b"late", 2)
    stage.call("Report", job, sequence=3, events=[{"type": "log", "message": "no picture"}])
    shown = stage.job(job)
    assert (shown["thumbnail_url"], shown["scene_name"]) == (f"/v1/blobs/{late}", "a scene")
    (listed,) = (each for each in stage.api.get("/v1/jobs").json()["items"] if each["id"] == job)
    assert listed["thumbnail_url"] == shown["thumbnail_url"]
    stage.call("Finish", job, outcome="OUTCOME_STOPPED")
    stage.end(0)


@pytest.mark.parametrize(
    ("files", "shown"),
    [
        (["manifest.json", "mesh/a.png", "preview/photo_a.png"], None),
        (["manifest.json", "preview/photo_a.png", "preview/c d.png", "preview/e.png"], "preview/c%20d.png"),
        (["manifest.json", "preview/a.png", "poster.webp"], "poster.webp"),
        (["manifest.json", "preview/a.png", "poster.webp", "thumbnail.webp"], "thumbnail.webp"),
    ],
)
def test_a_bundle_shows_its_poster_or_a_rendering_of_a_view(
    stage: Stage, tmp_path: Path, files: list[str], shown: str | None
):
    bundle_id = "bundle_" + sha256(" ".join(files).encode())[:8]
    add_bundle(stage.api, tmp_path, {path: path.encode() for path in files}, bundle_id=bundle_id)
    found = expect(stage.api.get(f"/v1/bundles/{bundle_id}"), 200)
    expected = None if shown is None else f"/v1/bundles/{bundle_id}/files/{shown}"
    assert found["thumbnail_url"] == expected
    items = expect(stage.api.get("/v1/bundles"), 200)["items"]
    assert next(each for each in items if each["id"] == bundle_id)["thumbnail_url"] == expected
    if expected is not None:
        assert stage.api.get(expected).status_code == 200
    assert (found["num_files"], found["size_bytes"]) == (len(files), sum(map(len, files)))
