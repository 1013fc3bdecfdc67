"""Labels of jobs, scenes and bundles: changed by merging, found by lists; and the turn of a waiting job."""

import json
from pathlib import Path

from lambent_proto import BUNDLE_VERSION
from lambent_server.jobs.rows import RUNNING, move
from support.api import STRANGER_KEY, TENANT, Api, expect, expect_problem, opened, served
from support.runs import staged
from support.server_rows import add_bundle

api = served()


def found(api: Api, kind: str, *labels: str) -> list[str]:
    """Return the ids of what has these labels."""
    return [each["id"] for each in expect(api.get(f"/v1/{kind}", params={"label": labels}), 200)["items"]]


def test_labels_are_merged_and_null_removes_one(api: Api, tmp_path: Path):
    add_bundle(api, tmp_path, {"manifest.json": b"{}"}, bundle_id="bundle_x")
    scene = expect(api.post("/v1/scenes", json={"name": "x", "labels": {"show": "a"}}), 201)
    assert scene["labels"] == {"show": "a"}
    for kind, identifier in (("scenes", scene["id"]), ("bundles", "bundle_x"), ("jobs", api.job()["id"])):
        path = f"/v1/{kind}/{identifier}"
        expect(api.patch(path, json={"labels": {"show": "b", "shot": "7", "take": "1"}}), 200)
        shown = expect(api.patch(path, json={"labels": {"take": None, "none": None}}), 200)
        assert shown["labels"] == api.get(path).json()["labels"] == {"show": "b", "shot": "7"}
        assert found(api, kind, "show=b", "shot=7") == [identifier]
        assert found(api, kind, "show=a") == found(api, kind, "show=b", "take=1") == []
        many = {str(number): "x" for number in range(31)}
        expect_problem(api.patch(path, json={"labels": many}), 422, "too_many_labels")
        assert api.get(path).json()["labels"] == {"show": "b", "shot": "7"}
        assert api.other(STRANGER_KEY).patch(path, json={"labels": {"show": "c"}}).status_code == 404


def test_deleted_things_are_found_by_no_label(api: Api, tmp_path: Path):
    add_bundle(api, tmp_path, {"manifest.json": b"{}"}, bundle_id="bundle_x")
    expect(api.patch("/v1/bundles/bundle_x", json={"labels": {"a": "b"}}), 200)
    scene = expect(api.post("/v1/scenes", json={"name": "x", "labels": {"a": "b"}}), 201)["id"]
    for path in (f"/v1/scenes/{scene}", "/v1/bundles/bundle_x"):
        expect(api.delete(path), 204)
    from lambent_server.database.service_schema import resource_labels
    from lambent_server.database.tenancy import rows

    with api.services.database.read() as connection:
        assert connection.execute(rows(TENANT, resource_labels)).all() == []


def test_a_bundle_begins_with_the_labels_of_its_job(tmp_path: Path):
    with staged(tmp_path) as stage:
        job = stage.start(labels={"shot": "3"})
        text = json.dumps({"schema_version": BUNDLE_VERSION}).encode()
        file = {"path": "manifest.json", "sha256": stage.put(job, text), "size_bytes": len(text)}
        bundle_id = stage.call("Publish", job, bundle_files=[file]).bundle_id
        assert found(stage.api, "bundles", "shot=3") == [bundle_id]


def test_a_waiting_job_gets_another_turn_and_a_running_one_does_not(tmp_path: Path):
    with staged(tmp_path, local_slots=1) as stage:
        first, second = (stage.api.job()["id"] for _ in range(2))
        changed = expect(stage.api.patch(f"/v1/jobs/{second}", json={"priority": 5}), 200)
        assert changed["priority"] == 5
        stage.controller.turn()
        assert [launch.job_id for launch in stage.executor.launches] == [second]
        path = f"/v1/jobs/{second}"
        expect_problem(stage.api.patch(path, json={"priority": 6}), 409, "job_not_waiting")
        # What it has already is not a change.
        expect(stage.api.patch(path, json={"priority": 5, "labels": {"a": "b"}}), 200)
        assert stage.job(first)["state"] == "queued"


def test_a_priority_above_that_of_the_operator_is_refused_wherever_it_is_given(tmp_path: Path):
    with opened(tmp_path / "data", max_priority=10) as api:
        job = api.job(priority=10)
        order = {"scene_id": job["scene_id"], "preset": "tiny", "priority": 11}
        asked = [
            api.post("/v1/jobs", json=order),
            api.patch(f"/v1/jobs/{job['id']}", json={"priority": 11}),
        ]
        for answer in asked:
            problem = expect_problem(answer, 422, "priority_too_high")
            assert problem["errors"][0]["pointer"] == "#/priority"
            assert "up to 10 here, not 11" in problem["errors"][0]["message"]
        assert api.get(f"/v1/jobs/{job['id']}").json()["priority"] == 10


def test_a_name_of_a_scene_can_be_changed(api: Api):
    scene = api.scene()
    assert expect(api.patch(f"/v1/scenes/{scene}", json={"name": "after"}), 200)["name"] == "after"
    assert RUNNING
    assert move
