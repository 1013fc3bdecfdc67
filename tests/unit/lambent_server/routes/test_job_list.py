"""Lists of jobs: searched, narrowed, in both orders, and quick among thousands."""

from pathlib import Path
from typing import Any

import pytest
from lambent_server.api.pagination import PageFilter
from lambent_server.database.schema import scenes
from lambent_server.database.tenancy import change
from lambent_server.jobs import queries as job_queries
from lambent_server.jobs.pages import Wanted
from sqlalchemy import event
from support.api import STRANGER_KEY, TENANT, Api, expect, expect_problem, opened, served

NAME = "Ährenblüte ΟΔΟΣΑ"


api = served(scope="module", max_queued_jobs=1000)


@pytest.fixture(scope="module")
def made(api: Api) -> dict[str, list[str]]:
    """Return the ids of jobs by the name of their scene, in the order they were made in."""
    found: dict[str, list[str]] = {}
    for place, name in enumerate(("Copper Kettle", "100% wool", "kettle_2", NAME)):
        scene_id = api.scene({f"{place}.png": name.encode()})
        with api.services.database.write() as connection:
            connection.execute(change(TENANT, scenes).where(scenes.c.id == scene_id).values(name=name))
        kinds = ("train", "check", "prepare")
        found[name] = [api.job(scene_id, kind=kind)["id"] for kind in kinds]
    return found


def ids(api: Api, **given: Any) -> list[str]:
    items = expect(api.get("/v1/jobs", params={"limit": 200, **given}), 200)["items"]
    return [job["id"] for job in items]


def test_words_are_looked_for_in_names_in_any_case_and_are_no_patterns(api: Api, made: dict[str, list[str]]):
    assert ids(api, q="KETTLE") == [*made["kettle_2"][::-1], *made["Copper Kettle"][::-1]]
    assert ids(api, q=" copper ") == made["Copper Kettle"][::-1]
    assert ids(api, q="%") == made["100% wool"][::-1]
    assert ids(api, q="e_2") == made["kettle_2"][::-1]
    assert ids(api, q="_") == made["kettle_2"][::-1]
    assert ids(api, q="silver") == []
    one = made["100% wool"][0]
    assert ids(api, q=one) == [one]
    assert len(ids(api, q="tin")) == 12
    items = api.other(STRANGER_KEY).get("/v1/jobs", params={"q": "kettle"}).json()["items"]
    assert items == []


@pytest.mark.parametrize("words", ["Ä", "ä", "ÄHREN", "BLÜTE", "blüte ο", "Οδοσα", "ΟΔΟΣ"])
def test_letters_outside_ascii_are_looked_for_in_any_case_too(
    api: Api, made: dict[str, list[str]], words: str
):
    assert ids(api, q=words) == made[NAME][::-1]


def test_letters_with_and_without_marks_are_different(api: Api, made: dict[str, list[str]]):
    assert made[NAME]
    assert ids(api, q="ahren") == []


def test_kinds_states_and_words_hold_together(api: Api, made: dict[str, list[str]]):
    assert ids(api, q="wool", kind=["train", "prepare"]) == made["100% wool"][::-2]
    assert ids(api, q="wool", kind="train", state="cancelled") == []
    api.post(f"/v1/jobs/{made['100% wool'][0]}:cancel")
    assert ids(api, q="wool", state=["cancelled", "failed"]) == made["100% wool"][:1]


def test_the_oldest_come_first_where_that_is_asked_for_page_by_page(api: Api, made: dict[str, list[str]]):
    every = [job_id for of_scene in made.values() for job_id in of_scene]
    found: list[str] = []
    given: dict[str, Any] = {"sort": "oldest", "limit": 4}
    while True:
        page = expect(api.get("/v1/jobs", params=given), 200)
        found += [job["id"] for job in page["items"]]
        if page["next_cursor"] is None:
            break
        given["cursor"] = page["next_cursor"]
    assert found == every
    assert ids(api) == every[::-1]


def test_words_that_cannot_be_are_refused(api: Api):
    for given in ({"q": "a\x01b"}, {"q": "x" * 101}, {"sort": "name"}, {"kind": ["train", "dance"]}):
        expect_problem(api.get("/v1/jobs", params=given), 422, "invalid_request")
    expect_problem(api.get("/v1/jobs", params={"q": "a\0b"}), 400, "target_invalid")


def test_a_page_of_one_state_reads_an_index_and_a_page_takes_the_same_few_queries(tmp_path: Path):
    with opened(tmp_path / "data", max_queued_jobs=1000) as api:
        scene_id = api.scene()
        for _ in range(30):
            api.job(scene_id)
        told: list[tuple[str, Any]] = []
        with api.services.database.read() as connection:
            event.listen(connection, "before_cursor_execute", lambda *given: told.append(given[2:4]))
            found, _ = job_queries.select_page(connection, TENANT, Wanted(states=["failed"]), PageFilter())
            assert found == []
            statement, values = next(each for each in told if each[0].startswith("SELECT"))
            plan = connection.exec_driver_sql(f"EXPLAIN QUERY PLAN {statement}", values).all()
            assert "ix_jobs_tenant_id_state_id" in str(plan)
            told.clear()
            found, _ = job_queries.select_page(connection, TENANT, Wanted(), PageFilter())
            assert len(job_queries.show_all(connection, TENANT, found)) == 30
            # The jobs, and the scenes of all of them.
            assert len(told) == 2
