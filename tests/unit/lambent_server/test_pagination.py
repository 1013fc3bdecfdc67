"""Lists of scenes and bundles, page by page, and how long a job is likely to take."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from lambent_server.clock import now
from lambent_server.database.schema import jobs
from lambent_server.database.tenancy import change
from support.api import STRANGER_KEY, TENANT, Api, expect, expect_problem, opened
from support.server_rows import add_bundle


@pytest.fixture
def api(tmp_path: Path) -> Iterator[Api]:
    with opened(tmp_path / "data") as api:
        yield api


def test_scenes_are_listed_newest_first_page_by_page(api: Api):
    made = [expect(api.post("/v1/scenes", json={"name": f"scene {n}"}), 201)["id"] for n in range(5)]
    seen, cursor = [], None
    while True:
        page = expect(
            api.get("/v1/scenes", params={"limit": 2, **({"cursor": cursor} if cursor else {})}), 200
        )
        seen += [each["id"] for each in page["items"]]
        cursor = page["next_cursor"]
        if cursor is None:
            break
        assert len(page["items"]) == 2
    assert seen == made[::-1]
    assert expect(api.other(STRANGER_KEY).get("/v1/scenes"), 200)["items"] == []
    expect_problem(api.get("/v1/scenes?cursor=!"), 422, "invalid_request")
    expect_problem(api.get("/v1/scenes?limit=0"), 422, "invalid_request")


def test_bundles_are_listed_with_what_they_are_made_of(api: Api, tmp_path: Path):
    scene_id = api.scene()
    add_bundle(api, tmp_path, {"manifest.json": b"{}", "asset.glb": b"12345"}, scene_id=scene_id)
    add_bundle(api, tmp_path, {"manifest.json": b"{ }"}, bundle_id="bundle_y")
    newest, oldest = expect(api.get("/v1/bundles"), 200)["items"]
    assert newest == {**newest, "id": "bundle_y", "scene_name": "", "num_files": 1}
    assert oldest == {**oldest, "scene_name": "a scene", "num_files": 2, "size_bytes": 7}
    files = expect(api.get("/v1/bundles/bundle_x"), 200)["files"]
    assert [each["path"] for each in files] == ["asset.glb", "manifest.json"]
    assert api.get(files[0]["url"]).content == b"12345"
    stranger = api.other(STRANGER_KEY)
    expect_problem(stranger.get("/v1/bundles/bundle_x"), 404, "bundle_not_found")
    assert expect(stranger.get("/v1/bundles"), 200)["items"] == []


def end(api: Api, job_id: str, seconds: float, **values: object) -> None:
    """Let a job have taken this long."""
    at = now()
    ended = {"state": "succeeded", "run": 1, "started_at": at - seconds, "finished_at": at, **values}
    with api.services.database.write() as connection:
        connection.execute(change(TENANT, jobs).where(jobs.c.id == job_id).values(**ended))


def test_an_estimate_is_the_budget_until_jobs_were_measured(api: Api):
    def ask(preset: str) -> dict:
        return expect(api.post("/v1/estimates", json={"preset": preset}), 200)

    budgets = {preset["name"]: preset["budget_s"] for preset in expect(api.get("/v1/presets"), 200)["items"]}
    fresh = ask("fast")
    assert (fresh["seconds"], fresh["num_measured"], fresh["num_ahead"]) == (budgets["fast"], 0, 0)
    assert budgets["fast"] > 0.0
    assert fresh["shortest_s"] is None
    scene_id = api.scene()
    for seconds in (100.0, 300.0, 140.0):
        end(api, api.job(scene_id, preset="fast")["id"], seconds)
    # None of these says how long a job of this preset takes.
    end(api, api.job(scene_id, preset="tiny")["id"], 1.0)
    end(api, api.job(scene_id, preset="fast")["id"], 2.0, state="failed")
    end(api, api.job(scene_id, preset="fast")["id"], 3.0, run=2)
    end(api, api.job(scene_id, preset="fast", params={"stage_one.num_steps": "1"})["id"], 4.0)
    end(api, api.job(scene_id, preset="fast", kind="check")["id"], 5.0)
    api.job(scene_id)
    measured = ask("fast")
    assert measured["seconds"] == pytest.approx(140.0)
    assert (measured["shortest_s"], measured["longest_s"]) == pytest.approx((100.0, 300.0))
    assert (measured["num_measured"], measured["num_ahead"]) == (3, 1)
    assert ask("paper_glossy")["seconds"] is None
    expect_problem(api.post("/v1/estimates", json={"preset": "x"}), 422, "preset_unknown")
