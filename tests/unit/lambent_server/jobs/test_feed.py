"""News of jobs: read once for all streams, handed to each without gaps."""

import asyncio
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from lambent_server.database.model import JobRow
from lambent_server.http.budget import REQUESTS, STREAMS, Budget, Place
from lambent_server.jobs import feed as feed_module
from lambent_server.jobs.feed import GIVE_WAY_S, Feed, Subscription
from lambent_server.jobs.queries import insert_job
from lambent_server.jobs.rows import NewEvent, append_event
from sqlalchemy import event
from support.api import STRANGER, TENANT, Api, opened


@pytest.fixture
def api(tmp_path: Path) -> Iterator[Api]:
    with opened(tmp_path / "data", stream_poll_s=0.2) as api:
        yield api


def add_job(api: Api) -> JobRow:
    values = {"kind": "train", "scene_id": "x", "preset": "tiny", "params": {}, "seed": 0}
    with api.services.database.write() as connection:
        return insert_job(connection, TENANT, labels={}, **values)


def add_events(api: Api, job: JobRow, count: int = 1) -> None:
    with api.services.database.write() as connection:
        for _ in range(count):
            append_event(connection, job, NewEvent(type="log", message="more"))
    api.services.wakeups.signal()


async def until(condition: Callable[[], Any]) -> None:
    async with asyncio.timeout(20.0):
        while not condition():
            await asyncio.sleep(0.01)


def selects(api: Api) -> list[str]:
    """Return a list that grows with every query."""
    asked: list[str] = []

    @event.listens_for(api.services.database.engine, "before_cursor_execute")
    def count(_c: object, _u: object, statement: str, *_: object) -> None:
        if statement.lstrip().startswith("SELECT"):
            asked.append(statement)

    return asked


def run_streams(api: Api, subscriptions: list[Subscription], act: Callable[[Feed], Any]) -> None:
    """Run `act` while these streams are open."""

    async def body() -> None:
        feed = Feed(api.services, Budget(api.services.settings))
        leave = [feed.subscribed(TENANT, each) for each in subscriptions]
        for each in leave:
            each.__enter__()
        await feed.begin()
        await act(feed)
        for each in leave:
            each.__exit__(None, None, None)
        await until(lambda: feed._reader is None or feed._reader.done())

    asyncio.run(body())


def test_a_hundred_streams_cost_as_many_queries_as_one(api: Api):
    job = add_job(api)
    asked = selects(api)
    counts = []
    for number in (1, 100):
        streams = [Subscription(frozenset({job.id}), {job.id: 1}) for _ in range(number)]

        async def act(feed: Feed, streams: list[Subscription] = streams) -> None:
            before = len(asked)
            at = feed.offered_at
            add_events(api, job)
            await until(lambda: all(stream._waiting for stream in streams))
            counts.append(len(asked) - before)
            assert feed.offered_at >= at

        run_streams(api, streams, act)
    # A look more or less, depending on when the signal comes.
    assert counts[1] <= counts[0] + 2


def test_idle_streams_are_offered_nothing_and_only_the_feed_reads(api: Api):
    job = add_job(api)
    streams = [Subscription(frozenset({job.id}), {job.id: 1}) for _ in range(200)]
    asked = selects(api)

    async def act(_: Feed) -> None:
        before = len(asked)
        await asyncio.sleep(1.0)
        assert 1 <= len(asked) - before <= 5
        assert not any(stream._waiting for stream in streams)

    run_streams(api, streams, act)


def test_every_change_is_offered_once_in_order(api: Api):
    job = add_job(api)
    stream = Subscription(frozenset(), {job.id: 1})
    got: list[int] = []

    async def act(_: Feed) -> None:
        for _ in range(5):
            add_events(api, job, 3)
            await asyncio.sleep(0.08)
        await until(lambda: sum(len(change.events) for change in stream._waiting) >= 15)
        changes = stream.take()
        assert changes is not None
        for change in changes:
            assert change.start == (got[-1] if got else 1)
            got.extend(seq for seq, _ in change.events)

    run_streams(api, [stream], act)
    assert got == list(range(2, 17))


def test_a_job_that_a_stream_has_never_seen_comes_with_a_snapshot(api: Api):
    old = add_job(api)
    named, every = (
        Subscription(frozenset({old.id}), {old.id: 1}),
        Subscription(frozenset(), {old.id: 1}),
    )

    async def act(_: Feed) -> None:
        new = add_job(api)
        api.services.wakeups.signal()
        await until(lambda: every._waiting)
        (change,) = every.take() or []
        assert change.snapshot is not None
        assert (change.job_id, change.snapshot.seq) == (new.id, 1)
        assert named.take() == []

    run_streams(api, [named, every], act)


def test_another_tenant_is_offered_nothing(api: Api):
    job = add_job(api)
    ours, theirs = Subscription(frozenset(), {}), Subscription(frozenset(), {})

    async def act(feed: Feed) -> None:
        with feed.subscribed(STRANGER, theirs):
            add_events(api, job)
            await until(lambda: ours._waiting)
        assert theirs.take() == []

    run_streams(api, [ours], act)


def test_a_stream_that_does_not_take_its_changes_is_told_to_read_them_itself(
    api: Api, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(feed_module, "MAX_WAITING", 3)
    job = add_job(api)
    slow, quick = (Subscription(frozenset({job.id}), {job.id: 1}) for _ in range(2))

    async def act(_: Feed) -> None:
        seen = 1
        while seen < 6:
            add_events(api, job)
            await until(lambda: quick._waiting)
            seen += sum(len(change.events) for change in quick.take() or [])
        assert len(slow._waiting) <= 3
        assert slow.take() is None
        assert slow.take() == []

    run_streams(api, [slow, quick], act)


def test_changes_that_nobody_signals_are_noticed_at_the_next_look(api: Api):
    job = add_job(api)
    stream = Subscription(frozenset(), {job.id: 1})

    async def act(_: Feed) -> None:
        with api.services.database.write() as connection:
            append_event(connection, job, NewEvent(type="log"))
        await until(lambda: stream._waiting)

    run_streams(api, [stream], act)


def test_the_newest_jobs_are_read_once_for_streams_that_begin_together_and_anew_after_a_change(api: Api):
    job = add_job(api)
    asked = selects(api)
    anchor = Subscription(frozenset(), {job.id: 1})

    async def act(feed: Feed) -> None:
        await feed.recent(TENANT)
        before = len(asked)
        shown = await asyncio.gather(*(feed.recent(TENANT) for _ in range(50)))
        assert len(asked) - before <= 2
        assert {each.seq for found in shown for each in found} == {1}
        add_events(api, job)
        await until(lambda: anchor._waiting)
        assert [each.seq for each in await feed.recent(TENANT)] == [2]

    run_streams(api, [anchor], act)


def test_the_feed_stops_reading_with_its_last_stream_and_begins_again(api: Api):
    job = add_job(api)
    for _ in range(2):
        stream = Subscription(frozenset(), {job.id: job.event_seq})

        async def act(_: Feed, stream: Subscription = stream) -> None:
            add_events(api, job)
            await until(lambda: stream._waiting)

        run_streams(api, [stream], act)


def test_a_database_that_fails_delays_the_news_and_loses_none(api: Api, monkeypatch: pytest.MonkeyPatch):
    job = add_job(api)
    stream = Subscription(frozenset(), {job.id: 1})
    look, failures = Feed._look, []

    def failing(self: Feed, *given: Any) -> Any:
        if len(failures) < 3 and not given[1]:
            failures.append(1)
            raise OSError("away")
        return look(self, *given)

    monkeypatch.setattr(Feed, "_look", failing)

    async def act(_: Feed) -> None:
        add_events(api, job)
        await until(lambda: stream._waiting)
        assert len(failures) == 3

    run_streams(api, [stream], act)


def test_streams_give_way_to_a_new_request_for_a_limited_time(api: Api):
    budget = Budget(api.services.settings)
    feed = Feed(api.services, budget)

    def seconds() -> float:
        began = time.monotonic()
        asyncio.run(feed._give_way())
        return time.monotonic() - began

    assert seconds() < GIVE_WAY_S / 2
    with Place(budget, REQUESTS) as place:
        place.take("address 10.0.0.1")
        assert seconds() >= GIVE_WAY_S * 0.9
        # One that waits for something, such as the end of a job, holds nobody up.
        budget.requested_at -= GIVE_WAY_S
        assert seconds() < GIVE_WAY_S / 2
    with Place(budget, STREAMS) as place:
        place.take("address 10.0.0.1")
        assert seconds() < GIVE_WAY_S / 2
