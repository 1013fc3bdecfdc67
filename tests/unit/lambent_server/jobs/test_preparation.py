"""Cameras and masks are kept with their scene: which runs are offered them, and when they go."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from lambent_server.database.schema import checkpoint_files, checkpoints
from lambent_server.database.tenancy import across_tenants
from lambent_server.maintenance.housekeeping import sweep
from support.api import expect, expect_problem, sha256
from support.runs import Stage, staged


@pytest.fixture
def stage(tmp_path: Path) -> Iterator[Stage]:
    with staged(tmp_path / "s", garbage_after_s=1e-6, local_slots=4) as stage:
        yield stage


def commit(stage: Stage, job: str, name: str, data: bytes, run: int = 1) -> None:
    """Commit a checkpoint of a stage that has one file."""
    digest = stage.put(job, data, run)
    files = [{"path": f"{name}/state", "sha256": digest, "size_bytes": len(data)}]
    stage.call("CommitCheckpoint", job, run, manifest={"stage": name, "step": 1, "files": files})


def offered(stage: Stage, job: str, run: int = 1) -> dict[str, str]:
    """Return the hash of each stage's file as a run is offered it."""
    found = stage.call("Start", job, run).checkpoints
    assert len({each.stage for each in found}) == len(found)
    return {each.stage: each.files[0].sha256 for each in found}


def succeed(stage: Stage, job: str) -> None:
    stage.call("Finish", job, outcome="OUTCOME_SUCCEEDED")
    stage.end(0)
    assert stage.job(job)["state"] == "succeeded"


def test_cameras_and_masks_outlive_the_job_and_serve_every_later_one_of_the_scene(stage: Stage):
    scene = stage.api.scene()
    first = stage.start(scene_id=scene)
    for name in ("cameras", "masks", "cache"):
        commit(stage, first, name, name.encode())
    succeed(stage, first)
    expect(stage.api.delete(f"/v1/jobs/{first}"), 204)
    sweep(stage.api.services)
    second = stage.start(scene_id=scene, preset="fast", params={"max_side": "16"})
    assert offered(stage, second) == {"cameras": sha256(b"cameras"), "masks": sha256(b"masks")}
    request = {"sha256": sha256(b"masks")}
    assert b"".join(piece.data for piece in stage.call("GetBlob", second, **request)) == b"masks"


def test_another_scene_and_other_kinds_of_jobs_are_offered_nothing(stage: Stage):
    scene = stage.api.scene()
    first = stage.start(scene_id=scene)
    commit(stage, first, "cameras", b"cameras")
    succeed(stage, first)
    assert offered(stage, stage.start(scene_id=stage.api.scene({"other.png": b"x"}))) == {}
    assert offered(stage, stage.start(scene_id=scene, kind="check")) == {}


def test_the_newest_of_a_scene_replaces_the_one_before(stage: Stage):
    scene = stage.api.scene()
    for data in (b"one", b"two"):
        job = stage.start(scene_id=scene)
        commit(stage, job, "masks", data)
        succeed(stage, job)
    with stage.api.services.database.read() as connection:
        assert len(connection.execute(across_tenants(checkpoints)).all()) == 1
    sweep(stage.api.services)
    assert stage.api.get(f"/v1/blobs/{sha256(b'one')}").status_code == 404
    assert offered(stage, stage.start(scene_id=scene)) == {"masks": sha256(b"two")}


def test_an_unfinished_job_goes_on_from_its_own_and_not_from_another_jobs_newer_one(stage: Stage):
    scene = stage.api.scene()
    patient = stage.start(scene_id=scene, seed=1)
    commit(stage, patient, "cameras", b"of seed one")
    stage.end(-9)
    assert stage.job(patient)["run"] == 2
    hasty = stage.start(scene_id=scene, seed=0)
    commit(stage, hasty, "cameras", b"of seed zero")
    assert offered(stage, patient, 2) == {"cameras": sha256(b"of seed one")}
    assert offered(stage, hasty) == {"cameras": sha256(b"of seed zero")}


def test_what_is_kept_goes_with_the_scene_and_so_do_its_bytes(stage: Stage):
    scene = stage.api.scene()
    job = stage.start(scene_id=scene)
    commit(stage, job, "cameras", b"cameras")
    expect_problem(stage.api.delete(f"/v1/scenes/{scene}"), 409, "scene_in_use")
    succeed(stage, job)
    sweep(stage.api.services)
    assert stage.api.get(f"/v1/blobs/{sha256(b'cameras')}").status_code == 200
    expect(stage.api.delete(f"/v1/scenes/{scene}"), 204)
    sweep(stage.api.services)
    assert stage.api.get(f"/v1/blobs/{sha256(b'cameras')}").status_code == 404
    with stage.api.services.database.read() as connection:
        for table in (checkpoints, checkpoint_files):
            assert connection.execute(across_tenants(table)).first() is None
