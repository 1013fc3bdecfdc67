"""Jobs over REST, without anything that runs them."""

import sqlite3
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.api import STRANGER_KEY, Api, expect, expect_problem, opened


@pytest.fixture(scope="module")
def api(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Api]:
    with opened(tmp_path_factory.mktemp("api") / "data") as api:
        yield api


@pytest.fixture(scope="module")
def scene(api: Api) -> str:
    return api.scene()


def test_a_job_is_accepted_and_can_be_looked_at(api: Api, scene: str):
    job = api.job(scene, labels={"asset": "cow"}, params={"stage_one.num_rays": "64"}, priority=3, seed=7)
    assert (job["state"], job["run"], job["gpus"]) == ("queued", 0, 0)
    assert expect(api.get(f"/v1/jobs/{job['id']}"), 200) == job
    events = expect(api.get(f"/v1/jobs/{job['id']}/events"), 200)["items"]
    assert [(each["seq"], each["type"], each["state"]) for each in events] == [(1, "state", "queued")]
    assert expect(api.get(f"/v1/jobs/{job['id']}/artifacts"), 200) == {"items": [], "next_cursor": None}
    assert api.get(f"/v1/jobs/{job['id']}/log").text == ""


@pytest.mark.parametrize(
    ("change", "pointer"),
    [
        ({"scene_id": 5}, "#/scene_id"),
        ({"unknown": 1}, "#/unknown"),
        ({"gpus": -1}, "#/gpus"),
        ({"gpus": "1"}, "#/gpus"),
        ({"priority": 10**6}, "#/priority"),
        ({"params": {"Bad Name": "1"}}, "#/params/Bad Name"),
        ({"params": {"a.b": 1}}, "#/params/a.b"),
        ({"params": {"a.b": 201 * "x"}}, "#/params"),
        ({"params": {"corrections": 65537 * "x"}}, "#/params/corrections"),
        ({"params": {"corrections": "\n"}}, "#/params/corrections"),
        ({"labels": {"a/b": "x"}}, "#/labels/a~1b"),
        ({"kind": "dance"}, "#/kind"),
        ({"seed": 1.5}, "#/seed"),
    ],
)
def test_what_cannot_be_used_is_pointed_at(api: Api, scene: str, change: dict, pointer: str):
    answer = api.post("/v1/jobs", json={"scene_id": scene, "preset": "tiny", **change})
    problem = expect_problem(answer, 422, "invalid_request")
    assert any(each["pointer"].startswith(pointer) for each in problem["errors"])


@pytest.mark.parametrize(
    ("order", "words"),
    [
        ({"gpus": 4}, "3 GPU"),
        ({"gpus": 2, "kind": "prepare"}, "only training can use several"),
        ({"preset": "standard", "gpus": 4}, "3 GPU"),
    ],
)
def test_more_gpus_than_a_job_can_use_are_refused(tmp_path: Path, order: dict, words: str):
    with opened(tmp_path / "data", local_gpus=3) as api:
        answer = api.post("/v1/jobs", json={"scene_id": api.scene(), "preset": "tiny", **order})
        problem = expect_problem(answer, 422, "unsatisfiable_resources")
        (error,) = problem["errors"]
        assert error["pointer"] == "#/gpus"
        assert words in error["message"]
        assert expect(api.get("/v1/limits"), 200)["max_gpus"] == 3
        assert api.job(api.scene(), gpus=3)["gpus"] == 3
        assert api.job(api.scene(), preset="standard")["gpus"] == 1


def test_corrections_are_the_one_long_setting_and_come_back_as_they_were(api: Api, scene: str):
    params = {"corrections": 65536 * "x", "a.b": 200 * "y"}
    job = api.job(scene, kind="prepare", params=params)
    assert (job["kind"], job["params"], job["gpus"]) == ("prepare", params, 0)


def test_jobs_of_a_scene_and_of_a_kind_are_found(api: Api):
    mine, other = api.scene({"a.png": b"a"}), api.scene({"b.png": b"b"})
    one, two = (api.job(mine, kind=kind)["id"] for kind in ("prepare", "check"))
    api.job(other, kind="prepare")
    found = expect(api.get(f"/v1/jobs?scene={mine}"), 200)["items"]
    assert [job["id"] for job in found] == [two, one]
    found = expect(api.get(f"/v1/jobs?scene={mine}&kind=prepare"), 200)["items"]
    assert [job["id"] for job in found] == [one]
    assert expect(api.other(STRANGER_KEY).get(f"/v1/jobs?scene={mine}"), 200)["items"] == []
    expect_problem(api.get("/v1/jobs?kind=dance"), 422, "invalid_request")


def test_what_does_not_exist_is_named(api: Api, scene: str):
    answer = api.post("/v1/jobs", json={"scene_id": scene, "preset": "huge"})
    assert expect_problem(answer, 422, "preset_unknown")["errors"][0]["pointer"] == "#/preset"
    answer = api.post("/v1/jobs", json={"scene_id": "scene_x", "preset": "tiny"})
    expect_problem(answer, 404, "scene_not_found")
    for path in ("", "/events", "/log", "/artifacts"):
        expect_problem(api.get(f"/v1/jobs/job_x{path}"), 404, "job_not_found")
    for verb in ("cancel", "retry"):
        expect_problem(api.post(f"/v1/jobs/job_x:{verb}"), 404, "job_not_found")


def test_a_body_that_is_no_json_is_a_400(api: Api):
    answer = api.post("/v1/jobs", content=b"{", headers={"content-type": "application/json"})
    expect_problem(answer, 400, "invalid_json")


def test_more_gpus_than_there_are_is_refused_at_once(api: Api, scene: str):
    answer = api.post("/v1/jobs", json={"scene_id": scene, "preset": "tiny", "gpus": 1})
    assert expect_problem(answer, 422, "unsatisfiable_resources")["errors"][0]["pointer"] == "#/gpus"
    answer = api.post("/v1/jobs", json={"scene_id": scene, "preset": "standard"})
    expect_problem(answer, 422, "unsatisfiable_resources")
    expect(api.post("/v1/jobs", json={"scene_id": scene, "preset": "standard", "gpus": 0}), 202)


def test_a_job_needs_a_committed_scene(api: Api):
    scene_id = api.scene(commit=False)
    answer = api.post("/v1/jobs", json={"scene_id": scene_id, "preset": "tiny"})
    expect_problem(answer, 409, "scene_not_committed")


def test_the_same_key_gives_the_same_job_and_another_body_is_refused(api: Api, scene: str):
    headers = {"Idempotency-Key": "key-1"}
    body = {"scene_id": scene, "preset": "tiny"}
    first = expect(api.post("/v1/jobs", json=body, headers=headers), 202)
    assert expect(api.post("/v1/jobs", json=body, headers=headers), 202)["id"] == first["id"]
    answer = api.post("/v1/jobs", json={**body, "seed": 1}, headers=headers)
    expect_problem(answer, 422, "idempotency_key_reused")


def test_a_key_of_a_refused_order_can_be_used_again(api: Api, scene: str):
    headers = {"Idempotency-Key": "key-2"}
    wrong = {"scene_id": "scene_x", "preset": "tiny"}
    expect_problem(api.post("/v1/jobs", json=wrong, headers=headers), 404, "scene_not_found")
    expect(api.post("/v1/jobs", json={"scene_id": scene, "preset": "tiny"}, headers=headers), 202)


def test_pages_hold_every_job_once_the_newest_first(tmp_path: Path):
    with opened(tmp_path / "data") as api:
        scene = api.scene()
        made = [api.job(scene, labels={"n": str(n % 2)})["id"] for n in range(7)]
        found, cursor = [], None
        while True:
            given = {"limit": 3} | ({"cursor": cursor} if cursor else {})
            page = expect(api.get("/v1/jobs", params=given), 200)
            found += [job["id"] for job in page["items"]]
            cursor = page["next_cursor"]
            if cursor is None:
                break
        assert found == made[::-1]
        odd = expect(api.get("/v1/jobs", params={"label": "n=1"}), 200)["items"]
        assert [job["id"] for job in odd] == made[1::2][::-1]
        api.post(f"/v1/jobs/{made[0]}:cancel")
        ended = expect(api.get("/v1/jobs", params={"state": ["cancelled", "failed"]}), 200)["items"]
        assert [job["id"] for job in ended] == made[:1]


def test_a_cursor_or_filter_that_was_made_up_is_refused(api: Api):
    expect_problem(api.get("/v1/jobs", params={"cursor": "_w"}), 422, "cursor_invalid")
    for given in ({"cursor": "%"}, {"state": "asleep"}, {"limit": 0}, {"label": "x"}, {"colour": "red"}):
        expect_problem(api.get("/v1/jobs", params=given), 422, "invalid_request")


def test_a_queued_job_is_cancelled_at_once_and_that_is_final(api: Api, scene: str):
    job = api.job(scene)
    assert expect(api.post(f"/v1/jobs/{job['id']}:cancel"), 202)["state"] == "cancelled"
    assert expect(api.post(f"/v1/jobs/{job['id']}:cancel"), 202)["state"] == "cancelled"
    events = expect(api.get(f"/v1/jobs/{job['id']}/events"), 200)["items"]
    assert [each["state"] for each in events] == ["queued", "cancelled"]
    again = expect(api.get(f"/v1/jobs/{job['id']}/events", params={"after": 1}), 200)["items"]
    assert again == events[1:]


def test_a_retry_is_a_new_job_with_the_same_order(api: Api, scene: str):
    job = api.job(scene, labels={"a": "b"}, seed=3)
    expect_problem(api.post(f"/v1/jobs/{job['id']}:retry"), 409, "job_not_ended")
    api.post(f"/v1/jobs/{job['id']}:cancel")
    fresh = expect(api.post(f"/v1/jobs/{job['id']}:retry"), 202)
    assert fresh["id"] != job["id"]
    assert (fresh["state"], fresh["labels"], fresh["seed"]) == ("queued", {"a": "b"}, 3)
    assert expect(api.get(f"/v1/jobs/{job['id']}"), 200)["state"] == "cancelled"


@pytest.mark.parametrize("name", ["export.atlas_size", "export.transport_size"])
def test_a_size_of_textures_that_no_run_makes_is_refused(api: Api, scene: str, name: str):
    given = {"scene_id": scene, "params": {name: "1000"}}
    problem = expect_problem(api.post("/v1/jobs", json=given), 422, "setting_invalid")
    # A run would read a number with blanks around it all the same.
    blanks = {"scene_id": scene, "params": {name: " 1000 "}}
    expect_problem(api.post("/v1/jobs", json=blanks), 422, "setting_invalid")
    assert problem["errors"][0]["pointer"] == f"#/params/{name}"
    assert "multiples of 16" in problem["detail"]
    assert api.job(scene, params={name: "1024"})["params"] == {name: "1024"}


def test_a_full_queue_is_a_quota_with_its_figures(tmp_path: Path):
    with opened(tmp_path / "data", max_queued_jobs=2) as api:
        scene = api.scene()
        api.job(scene)
        api.job(scene)
        answer = api.post("/v1/jobs", json={"scene_id": scene, "preset": "tiny"})
        problem = expect_problem(answer, 429, "quota_jobs")
        assert problem["quota"] == {"name": "max_queued_jobs", "limit": 2, "used": 2}
        assert problem["retryable"]


def test_waiting_returns_at_the_end_of_the_time(api: Api, scene: str):
    job = api.job(scene)
    assert expect(api.get(f"/v1/jobs/{job['id']}", params={"wait": 0.1}), 200)["state"] == "queued"
    expect_problem(api.get(f"/v1/jobs/{job['id']}", params={"wait": 1000}), 422, "invalid_request")


def test_an_accepted_job_is_in_the_file_when_the_answer_comes(api: Api, scene: str):
    job = api.job(scene)
    database = sqlite3.connect(api.services.settings.data / "lambent.sqlite")
    assert database.execute("SELECT state FROM jobs WHERE id = ?", (job["id"],)).fetchone() == ("queued",)
    assert database.execute("PRAGMA journal_mode").fetchone() == ("wal",)
    database.close()
