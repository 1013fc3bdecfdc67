"""Deleting jobs, bundles and environments: what goes, what stays, what is in use."""

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from lambent_server.core.clock import now
from lambent_server.database.schema import artifacts, bundles, environments, garbage, jobs
from lambent_server.database.tenancy import across_tenants, add, change
from support.api import STRANGER_KEY, TENANT, Api, expect, expect_problem, opened
from support.server_rows import add_bundle


@pytest.fixture
def api(tmp_path: Path) -> Iterator[Api]:
    with opened(tmp_path / "data") as api:
        yield api


def add_environment(api: Api) -> str:
    values = {"name": "sky.exr", "format": "exr", "width": 2, "height": 1, "size_bytes": 1.0}
    with api.services.database.write() as connection:
        connection.execute(add(TENANT, environments, id="env_x", sha256="e" * 64, created_at=now(), **values))
    return "env_x"


def order_render(api: Api) -> dict[str, Any]:
    body = {
        "bundle_id": "bundle_x",
        "environments": [{"environment_id": "env_x"}],
        "cameras": {"turntable": 1, "size": 16},
    }
    return expect(api.post("/v1/renders", json=body, headers={"idempotency-key": "one"}), 202)


def discarded(api: Api) -> set[str]:
    with api.services.database.read() as connection:
        return set(connection.execute(across_tenants(garbage, garbage.c.sha256)).scalars())


def end(api: Api, job_id: str, **values: Any) -> None:
    with api.services.database.write() as connection:
        connection.execute(
            change(TENANT, jobs).where(jobs.c.id == job_id).values(state="succeeded", **values)
        )


def test_a_job_that_has_ended_goes_with_its_history_artifacts_and_log_and_its_bundle_stays(
    api: Api, tmp_path: Path
):
    add_bundle(api, tmp_path, {"manifest.json": b"{}"})
    job_id = api.job(labels={"a": "b"})["id"]
    log = api.services.settings.runs / job_id / "run-1.log"
    log.parent.mkdir()
    log.write_text("words")
    file = {"sha256": "a" * 64, "size_bytes": 1.0, "media_type": "image/png"}
    with api.services.database.write() as connection:
        connection.execute(add(TENANT, artifacts, job_id=job_id, name="a.png", **file))
    expect_problem(api.delete(f"/v1/jobs/{job_id}"), 409, "job_in_use")
    end(api, job_id, handle={"pid": 1, "run": "x/1"})
    expect_problem(api.delete(f"/v1/jobs/{job_id}"), 409, "job_in_use")
    end(api, job_id, handle=None)
    expect_problem(api.other(STRANGER_KEY).delete(f"/v1/jobs/{job_id}"), 404, "job_not_found")
    expect(api.delete(f"/v1/jobs/{job_id}"), 204)
    expect_problem(api.delete(f"/v1/jobs/{job_id}"), 404, "job_not_found")
    assert expect(api.get("/v1/jobs"), 200)["items"] == []
    assert expect(api.get("/v1/jobs?label=a=b"), 200)["items"] == []
    assert not log.parent.exists()
    assert "a" * 64 in discarded(api)
    expect(api.get("/v1/bundles/bundle_x"), 200)


def test_a_bundle_goes_with_its_files_and_links_unless_a_job_needs_it(api: Api, tmp_path: Path):
    add_bundle(api, tmp_path, {"manifest.json": b"{}"})
    add_environment(api)
    expect(api.post("/v1/bundles/bundle_x/shares", json={}), 201)
    job_id = order_render(api)["id"]
    assert job_id in expect_problem(api.delete("/v1/bundles/bundle_x"), 409, "bundle_in_use")["detail"]
    expect_problem(api.delete("/v1/environments/env_x"), 409, "environment_in_use")
    end(api, job_id, bundle_id="bundle_x")
    with api.services.database.write() as connection:
        connection.execute(change(TENANT, bundles).values(job_id=job_id))
    expect_problem(api.other(STRANGER_KEY).delete("/v1/bundles/bundle_x"), 404, "bundle_not_found")
    expect(api.delete("/v1/bundles/bundle_x"), 204)
    expect_problem(api.get("/v1/bundles/bundle_x"), 404, "bundle_not_found")
    expect_problem(api.delete("/v1/bundles/bundle_x"), 404, "bundle_not_found")
    assert expect(api.get(f"/v1/jobs/{job_id}"), 200)["bundle_id"] is None
    assert len(discarded(api)) == 1
    expect_problem(api.other(STRANGER_KEY).delete("/v1/environments/env_x"), 404, "environment_not_found")
    expect(api.delete("/v1/environments/env_x"), 204)
    assert expect(api.get("/v1/environments"), 200)["items"] == []
    assert "e" * 64 in discarded(api)
    expect_problem(api.delete("/v1/environments/env_x"), 404, "environment_not_found")


def test_what_a_bake_reads_stays_until_it_has_ended(api: Api, tmp_path: Path):
    scene_id = api.scene()
    add_bundle(api, tmp_path, {"manifest.json": b"{}"}, scene_id=scene_id)
    add_environment(api)
    job = api.job(scene_id, kind="bake", params={"bundle": "bundle_x", "environment": "env_x"})
    expect_problem(api.delete("/v1/bundles/bundle_x"), 409, "bundle_in_use")
    expect_problem(api.delete("/v1/environments/env_x"), 409, "environment_in_use")
    expect(api.post(f"/v1/jobs/{job['id']}:cancel"), 202)
    expect(api.delete("/v1/bundles/bundle_x"), 204)
    expect(api.delete("/v1/environments/env_x"), 204)


def test_the_last_job_of_an_order_takes_the_order_with_it(api: Api, tmp_path: Path):
    add_bundle(api, tmp_path, {"manifest.json": b"{}"})
    add_environment(api)
    first = order_render(api)["id"]
    assert order_render(api)["id"] == first
    end(api, first)
    expect(api.delete(f"/v1/jobs/{first}"), 204)
    # The key led to what is gone: the order is a new one.
    assert order_render(api)["id"] != first
    with api.services.database.read() as connection:
        assert len(connection.execute(across_tenants(bundles)).all()) == 1


def test_a_deleted_jobs_folder_that_is_gone_already_is_no_mistake(api: Api):
    job_id = api.job()["id"]
    end(api, job_id)
    shutil.rmtree(api.services.settings.runs)
    expect(api.delete(f"/v1/jobs/{job_id}"), 204)
