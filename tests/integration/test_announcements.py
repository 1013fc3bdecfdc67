"""Two servers on one PostgreSQL learn of each other's changes at once, whatever happens to the connection."""

import asyncio
import contextlib
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from lambent_server.core.settings import Settings
from lambent_server.database.engine import Database, announce
from lambent_server.database.listening import Listener
from lambent_server.database.model import JobRow
from lambent_server.database.tenancy import Tenant
from lambent_server.http.budget import Budget
from lambent_server.jobs.feed import Feed, Subscription
from lambent_server.jobs.queries import insert_job
from lambent_server.jobs.rows import NewEvent, append_event
from lambent_server.services import open_services
from sqlalchemy import text
from support.databases import postgresql

pytestmark = [pytest.mark.services, pytest.mark.slow]
TENANT = Tenant("default")


@pytest.fixture(scope="module")
def url() -> Iterator[str]:
    with postgresql() as url:
        yield url


@pytest.fixture
def database(url: str) -> Iterator[Database]:
    database = Database(Settings(database=url).database_url)
    database.migrate()
    with contextlib.closing(database):
        yield database


async def until(condition: Callable[[], Any], timeout_s: float = 20.0) -> None:
    async with asyncio.timeout(timeout_s):
        while not condition():
            await asyncio.sleep(0.01)


def listening(database: Database, url: str, act: Callable[[Listener, list[int]], Any]) -> None:
    """Run `act` with a listener that listens, and the list of its signals."""

    async def body() -> None:
        signals: list[int] = []
        listener = Listener(url, database, lambda: signals.append(1))
        task = asyncio.create_task(listener.run())
        await until(lambda: listener.listening)
        signals.clear()
        await act(listener, signals)
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)

    asyncio.run(body())


def add_job(database: Database) -> JobRow:
    values = {"kind": "train", "scene_id": "x", "preset": "tiny", "params": {}, "seed": 0}
    with database.write() as connection:
        return insert_job(connection, TENANT, labels={}, **values)


def test_a_change_is_announced_when_it_is_committed_and_not_before(database: Database, url: str):
    async def act(_: Listener, signals: list[int]) -> None:
        job = add_job(database)
        await until(lambda: signals)
        signals.clear()
        with database.write() as connection:
            append_event(connection, job, NewEvent(type="log"))
            await asyncio.sleep(0.3)
            assert not signals
        await until(lambda: signals)

    listening(database, url, act)


def test_a_change_that_is_rolled_back_is_not_announced(database: Database, url: str):
    async def act(_: Listener, signals: list[int]) -> None:
        with contextlib.suppress(ZeroDivisionError), database.write() as connection:
            announce(connection)
            raise ZeroDivisionError
        await asyncio.sleep(0.5)
        assert not signals

    listening(database, url, act)


def test_a_lost_connection_is_made_again_and_what_was_missed_is_signalled(database: Database, url: str):
    async def act(listener: Listener, signals: list[int]) -> None:
        with database.write() as connection:
            ours = "FROM pg_stat_activity WHERE application_name = 'lambent listener'"
            connection.execute(
                text(f"SELECT pg_terminate_backend(pid) {ours} AND datname = current_database()")
            )
        await until(lambda: not listener.listening)
        # This announcement has no listener.
        add_job(database)
        await until(lambda: listener.listening)
        assert signals
        signals.clear()
        add_job(database)
        await until(lambda: signals)

    listening(database, url, act)


def test_a_way_on_which_announcements_do_not_arrive_is_given_up(
    database: Database, url: str, monkeypatch: pytest.MonkeyPatch
):
    """As behind a pooler that gives every transaction another connection."""
    monkeypatch.setattr("lambent_server.database.listening.HEARD_WITHIN_S", 0.5)
    monkeypatch.setattr(Listener, "_announce", lambda self, token: None)
    signals: list[int] = []
    listener = Listener(url, database, lambda: signals.append(1))
    asyncio.run(asyncio.wait_for(listener.run(), 20.0))
    assert not listener.listening
    assert not signals


def test_a_stream_of_another_server_gets_an_event_long_before_the_next_poll(url: str, tmp_path: Path):
    given = {"database": url, "disk_floor_bytes": 0, "stream_poll_s": 60.0}
    here = open_services(Settings(data=tmp_path / "here", **given))
    there = open_services(Settings(data=tmp_path / "there", **given))
    job = add_job(here.database)

    async def body() -> None:
        listener = Listener(here.settings.listening_url, here.database, here.wakeups.signal)
        task = asyncio.create_task(listener.run())
        await until(lambda: listener.listening)
        feed, stream = Feed(here, Budget(here.settings)), Subscription(frozenset({job.id}), {job.id: 1})
        with feed.subscribed(TENANT, stream):
            await feed.begin()
            await asyncio.sleep(0.5)
            began = time.monotonic()
            with there.database.write() as connection:
                append_event(connection, job, NewEvent(type="log", message="from there"))
            await until(lambda: stream._waiting)
            assert time.monotonic() - began < 15.0
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)

    with contextlib.closing(here.database), contextlib.closing(there.database):
        asyncio.run(body())


def test_a_direct_address_is_used_for_listening_only():
    settings = Settings(
        database="postgresql://pooler:6432/lambent", database_direct="postgresql://server/lambent"
    )
    assert settings.database_url == "postgresql+psycopg://pooler:6432/lambent"
    assert settings.listening_url == "postgresql+psycopg://server/lambent"
    assert (
        Settings(database="postgresql://server/lambent").listening_url
        == "postgresql+psycopg://server/lambent"
    )
