"""The stream of events: how many jobs it follows, what an idle one costs."""

import asyncio
from collections.abc import Iterator
from pathlib import Path

import pytest
from lambent_server.job_queries import insert_job
from lambent_server.routes.events import Feed
from sqlalchemy import event
from support.api import STRANGER, TENANT, Api, expect_problem, opened


@pytest.fixture
def api(tmp_path: Path) -> Iterator[Api]:
    with opened(tmp_path / "data", max_streams=1) as api:
        # Streams send what there is and end.
        api.services.wakeups.closing = True
        yield api


def add_jobs(api: Api, count: int) -> list[str]:
    values = {"kind": "train", "scene_id": "x", "preset": "tiny", "params": {}, "seed": 0}
    with api.services.database.write() as connection:
        return [insert_job(connection, TENANT, labels={}, **values)["id"] for _ in range(count)]


def test_a_stream_follows_as_many_jobs_as_a_batch_can_have(api: Api):
    names = add_jobs(api, 300)
    answer = api.get("/v1/events", params={"job": names})
    assert answer.status_code == 200
    assert answer.text.count("event: snapshot") == 300
    positions = ",".join(f"{name}:1" for name in names)
    again = api.get("/v1/events", params={"job": names}, headers={"last-event-id": positions})
    assert again.status_code == 200
    assert "snapshot" not in again.text


def test_a_stream_too_many_is_refused_and_told_when_to_come_again(api: Api):
    api.app.state.feed.num_open[TENANT.id] = 1
    answer = api.get("/v1/events")
    assert expect_problem(answer, 429, "quota_streams")["quota"]["name"] == "max_streams"
    assert answer.headers["retry-after"]


def test_streams_read_the_database_together(api: Api):
    (name,) = add_jobs(api, 1)
    asked: list[str] = []

    @event.listens_for(api.services.database.engine, "before_cursor_execute")
    def count(_c: object, _u: object, statement: str, *_: object) -> None:
        asked.append(statement)

    async def look() -> None:
        feed = Feed(api.services)
        later = [feed.changes(TENANT, 1.0) for _ in range(100)]
        assert await asyncio.gather(*later) == [{name: 1}] * 100
        assert await feed.changes(STRANGER, 1.0) == {}

    asyncio.run(look())
    assert len([statement for statement in asked if "SELECT" in statement]) == 1
