"""The stream of events: how many jobs it follows, what an idle one costs."""

import asyncio
import json
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from lambent_server.accounts.scopes import READ
from lambent_server.accounts.who import Who
from lambent_server.http.budget import STREAMS, Budget, Place
from lambent_server.jobs.event_routes import _Stream
from lambent_server.jobs.feed import Change, Feed
from lambent_server.jobs.queries import insert_job, require_job
from lambent_server.jobs.rows import NewEvent, append_event
from sqlalchemy.exc import OperationalError
from support.api import STRANGER, TENANT, Api, expect, expect_problem, opened

READER = Who(tenant=TENANT, kind="key", id="key_test", scopes=frozenset({READ}))


@pytest.fixture
def api(tmp_path: Path) -> Iterator[Api]:
    with opened(tmp_path / "data", max_streams=8) as api:
        # Streams send what there is and end.
        api.services.wakeups.closing = True
        yield api


def add_jobs(api: Api, count: int) -> list[str]:
    values = {"kind": "train", "scene_id": "x", "preset": "tiny", "params": {}, "seed": 0}
    with api.services.database.write() as connection:
        return [insert_job(connection, TENANT, labels={}, **values).id for _ in range(count)]


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
    (name,) = add_jobs(api, 1)
    budget = api.app.state.budget
    limit = budget.limits[STREAMS].client
    places = [Place(budget, STREAMS) for _ in range(limit)]
    for place in places:
        place.take("address testclient")
    quota = expect_problem(api.get("/v1/events"), 429, "quota_streams")["quota"]
    assert quota == {"name": "max_streams", "of": "address", "limit": limit, "used": limit}
    answer = api.get("/v1/events")
    assert int(answer.headers["retry-after"]) > 0
    assert answer.headers["connection"] == "close"
    # Nothing else is affected.
    assert api.get(f"/v1/jobs/{name}").status_code == 200
    places[0].__exit__(None, None, None)
    assert api.get("/v1/events").status_code == 200


def test_a_stream_leaves_nothing_behind(api: Api):
    name = add_jobs(api, 1)[0]
    for query in ({}, {"job": [name]}):
        assert api.get("/v1/events", params=query).status_code == 200
    expect_problem(api.get("/v1/events", params={"job": ["job_unknown"]}), 404, "job_not_found")
    assert api.app.state.feed._streams == {}
    assert not api.app.state.budget.used


def messages(answer: Any) -> list[tuple[str, str, dict[str, Any]]]:
    """Return kind, id and data of every message; the id stays the last one if a message has none."""
    found, identifier = [], ""
    for part in answer.text.split("\n\n"):
        fields = dict(line.split(": ", 1) for line in part.splitlines() if not line.startswith(":"))
        identifier = fields.get("id", identifier)
        if "data" in fields:
            found.append((fields["event"], identifier, json.loads(fields["data"])))
    return found


def test_a_stream_of_all_jobs_that_comes_back_gets_what_it_missed_of_any_job(api: Api):
    """Also of jobs that are neither among the newest nor among those that its ids name."""
    names = add_jobs(api, 160)
    first = messages(api.get("/v1/events"))
    assert len(first) == 100
    last_id = first[-1][1]
    assert last_id.count(":") == 50
    missed = names[0]
    with api.services.database.write() as connection:
        for name in (missed, names[-1], names[70]):
            job = require_job(connection, TENANT, name)
            append_event(connection, job, NewEvent(type="log", message="meanwhile"))
    again = messages(api.get("/v1/events", headers={"last-event-id": last_id}))
    by_job = {data.get("job_id") or data["id"]: (kind, data) for kind, _, data in again}
    for name in (missed, names[-1], names[70]):
        kind, data = by_job[name]
        assert (data["seq"] if kind == "event" else data["last_event"]) == 2
    known = {part.partition(":")[0] for part in last_id.split(",")}
    assert all(kind == "event" for kind, _, data in again if data.get("job_id") in known)


def test_ids_say_where_the_client_is_in_every_named_job_from_the_first_message(api: Api):
    names = add_jobs(api, 3)
    with api.services.database.write() as connection:
        for name in names[:2]:
            append_event(connection, require_job(connection, TENANT, name), NewEvent(type="log"))
    known = {"last-event-id": f"{names[0]}:1,{names[1]}:1"}
    got = messages(api.get("/v1/events", params={"job": names}, headers=known))
    assert [kind for kind, _, _ in got] == ["snapshot", "event", "event"]
    for _, identifier, _ in got:
        assert {part.partition(":")[0] for part in identifier.split(",")} == set(names)
    positions = dict(part.split(":") for part in got[-1][1].split(","))
    assert positions == {names[0]: "2", names[1]: "2", names[2]: "1"}


def test_a_stream_that_fell_behind_goes_on_from_its_own_position(api: Api):
    """As one whose client was slow, or that was not there when the feed offered something."""
    name = add_jobs(api, 1)[0]

    async def body() -> None:
        feed = Feed(api.services, Budget(api.services.settings))
        stream = _Stream(api.services, feed, TENANT, frozenset({name}), {}, lambda: READER)
        try:
            assert len(await stream.begin()) == 1
            with api.services.database.write() as connection:
                job = require_job(connection, TENANT, name)
                for _ in range(4):
                    append_event(connection, job, NewEvent(type="log"))
            # Events 2 to 4 were never offered.
            stream._subscription.offer([Change(name, 4, ((5, "{}"),), None)])
            text = "".join(await stream._news())
            assert [f"{name}:{number}\n" in text for number in (2, 3, 4, 5)] == [True] * 4
            # And what it has already is not sent twice.
            stream._subscription.offer([Change(name, 3, ((4, "{}"), (5, "{}")), None)])
            assert await stream._news() == []
        finally:
            stream.close()

    api.services.wakeups.closing = False
    asyncio.run(body())


@pytest.fixture
def live(tmp_path: Path) -> Iterator[Api]:
    """Return an interface whose streams continue, and are checked often."""
    with opened(tmp_path / "live", max_streams=8, stream_ping_s=0.1) as api:
        yield api


def sent(api: Api, identify: Callable[[], Who | None], *, busy: bool = False) -> list[str]:
    """Return what a stream sends until it ends by itself; TimeoutError if it does not."""
    name = add_jobs(api, 1)[0]

    async def offer(stream: _Stream) -> None:
        for number in range(2, 10_000):
            stream._subscription.offer([Change(name, number - 1, ((number, "{}"),), None)])
            await asyncio.sleep(0.01)

    async def body() -> list[str]:
        feed = Feed(api.services, Budget(api.services.settings))
        stream = _Stream(api.services, feed, TENANT, frozenset({name}), {}, identify)
        offering = None
        try:
            first = await stream.begin()
            offering = asyncio.create_task(offer(stream)) if busy else None
            async with asyncio.timeout(20):
                return [message async for message in stream.run(first)]
        finally:
            if offering is not None:
                offering.cancel()
            stream.close()

    return asyncio.run(body())


class Answers:
    """Says who it is, and at last the last answer."""

    def __init__(self, *answers: Any) -> None:
        self.left = list(answers)

    def __call__(self) -> Who | None:
        answer = self.left.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return answer


LOST = {
    "invalid": None,
    "without the scope": replace(READER, scopes=frozenset()),
    "of another organisation": replace(READER, tenant=STRANGER),
}


@pytest.mark.parametrize("lost", LOST)
def test_a_stream_ends_when_its_client_may_no_longer_read(live: Api, lost: str):
    away = OperationalError("select", {}, Exception("away"))
    answers = Answers(READER, away, LOST[lost])
    messages = sent(live, answers)
    assert messages[0].startswith(": hello")
    assert messages[1:] == [": ping\n\n"] * 2
    assert answers.left == []


def test_a_stream_that_always_has_news_ends_too(live: Api):
    answers = Answers(READER, None)
    assert len(sent(live, answers, busy=True)) > 2
    assert answers.left == []


@pytest.mark.parametrize("kind", ["key", "session"])
def test_an_open_stream_ends_with_the_key_or_the_session(live: Api, kind: str):
    made = expect(live.post("/v1/keys", json={"name": "k"}), 201)
    headers = {"authorization": f"Bearer {made['key']}"}
    if kind == "session":
        code = expect(live.post("/v1/login-links", headers=headers), 201)["url"].partition("code=")[2]
        cookie = live.other(None).post("/v1/login", json={"code": code}).headers["set-cookie"]
        headers = {"authorization": "", "cookie": cookie.partition(";")[0]}
    with ThreadPoolExecutor(1) as pool:
        answer = pool.submit(live.client.get, "/v1/events", headers=headers)
        while not live.app.state.feed._streams:
            assert not answer.done(), answer.result().text
        expect(live.delete(f"/v1/keys/{made['id']}"), 204)
        try:
            assert answer.result(timeout=20).text.startswith(": hello")
        finally:
            live.services.wakeups.closing = True
