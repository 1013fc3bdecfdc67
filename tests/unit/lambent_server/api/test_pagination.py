"""Lists of scenes and bundles, page by page, and how long a job is likely to take."""

import base64
from contextlib import ExitStack
from pathlib import Path

import pytest
from lambent_server.core.clock import now
from lambent_server.database.schema import artifacts, jobs
from lambent_server.database.tenancy import add, change
from support.api import STRANGER_KEY, TENANT, Api, expect, expect_problem, opened, served
from support.databases import postgresql
from support.server_rows import add_bundle

api = served()


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


def cursor_of(text: bytes) -> str:
    """Return a cursor with this text."""
    return base64.urlsafe_b64encode(text).decode().rstrip("=")


IDS = (b"", b"\0", b"a b", b"\xff", "é".encode(), b"a" * 65, b"a\n", b"%", b"['a']")
VALUES = (
    *(
        b"",
        b"1",
        b"[]",
        b"[1,2]",
        b'["1"]',
        b"[true]",
        b"[1.0]",
        b"[-1]",
        b"[null]",
        b"{}",
        b"[NaN]",
        b"[\xff]",
    ),
    *(
        b"[" + b"9" * 300 + b"]",
        b"[2147483648]",
        b"[" * 1400,
        b"[" * 700 + b"]" * 700,
        b"[9223372036854775808]",
    ),
)
NAMES = (rb'["\ud800"]', rb'["\u0000"]', b'["\xed\xa0\x80"]', b"[1]", b'["a","b"]')


@pytest.mark.parametrize("kind", ["sqlite", "postgresql"])
def test_forged_cursors_are_refused(kind: str, tmp_path: Path):
    with ExitStack() as stack:
        given = {"database": stack.enter_context(postgresql())} if kind == "postgresql" else {}
        api = stack.enter_context(opened(tmp_path / "data", **given))
        job = api.job()["id"]
        lists = dict.fromkeys(("scenes", "jobs", "bundles", "keys", "webhooks", "deliveries", "audit"), IDS)
        lists |= {"batches": IDS, "environments": IDS, f"jobs/{job}/events": VALUES}
        lists[f"jobs/{job}/artifacts"] = NAMES
        for path, texts in lists.items():
            for text in texts:
                answer = api.get(f"/v1/{path}", params={"cursor": cursor_of(text)})
                assert answer.status_code == 422, (path, text, answer.text)
        # Another spelling of a cursor that would do.
        spelt = cursor_of(b"job_0")[:-1] + "x"
        expect_problem(api.get("/v1/jobs", params={"cursor": spelt}), 422, "cursor_invalid")
        expect(api.get("/v1/jobs", params={"cursor": cursor_of(b"job_0")}), 200)


def test_a_list_of_long_names_has_a_cursor_that_is_accepted(api: Api):
    job = api.job()["id"]
    names = [f"{'😀' * 60}/{'😀' * 60}/{'😀' * 60}/{number:02d}" for number in range(3)]
    with api.services.database.write() as connection:
        for name in names:
            values = {"sha256": "0" * 64, "size_bytes": 1.0, "media_type": "a/b"}
            connection.execute(add(TENANT, artifacts, job_id=job, name=name, **values))
    seen, cursor = [], None
    while cursor or not seen:
        params = {"limit": 1, **({"cursor": cursor} if cursor else {})}
        page = expect(api.get(f"/v1/jobs/{job}/artifacts", params=params), 200)
        seen += [each["name"] for each in page["items"]]
        cursor = page["next_cursor"]
    assert seen == names
