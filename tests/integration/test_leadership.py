"""The leader's lease on PostgreSQL, which ends by itself."""

import contextlib
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from lambent_server.cluster.membership import Membership, members
from lambent_server.cluster.shared_secrets import SHARE, WORKER, shared_secret
from lambent_server.core.settings import Settings
from lambent_server.database.engine import Database
from lambent_server.database.leadership import Leadership
from sqlalchemy import text
from support.databases import postgresql
from support.live_server import wait_until

pytestmark = [pytest.mark.services, pytest.mark.slow]


@pytest.fixture(scope="module")
def database() -> Iterator[Database]:
    with postgresql() as url, contextlib.closing(Database(Settings(database=url).database_url)) as found:
        found.migrate()
        yield found


@pytest.fixture(autouse=True)
def fresh(database: Database) -> None:
    with database.write() as connection:
        connection.execute(text("UPDATE leadership SET holder = '', expires_at = 0"))
        connection.execute(text("DELETE FROM servers"))
        connection.execute(text("DELETE FROM shared_secrets"))


def test_the_lead_passes_on_when_the_leader_is_silent_and_terms_are_counted(database: Database):
    first, second = (Leadership(database, name, 0.5) for name in ("a", "b"))
    assert first.beat()
    assert not second.beat()
    assert first.beat()
    term = first.term
    time.sleep(0.6)
    # It knows without asking.
    assert not first.is_held
    assert second.beat()
    assert (second.is_held, second.term) == (True, term + 1)
    assert not first.beat()


def test_a_silent_leader_is_followed_though_the_clock_of_the_database_was_set_back(database: Database):
    first, second = (Leadership(database, name, 0.5) for name in ("a", "b"))
    assert first.beat()
    assert not second.beat()
    with database.write() as connection:
        connection.execute(text("UPDATE leadership SET expires_at = expires_at + 600"))
    # As often as a leader that lives.
    began = time.monotonic()
    while not second.beat():
        assert time.monotonic() - began < 5.0
        time.sleep(0.05)
    assert time.monotonic() - began > 0.5
    assert not first.is_held
    # And the new one is obeyed as long as it beats.
    first.beat()
    for _ in range(8):
        time.sleep(0.1)
        assert second.beat()
        assert not first.beat()


def test_a_dead_server_does_not_live_on_when_the_clock_of_the_database_was_set_back(
    database: Database, tmp_path: Path
):
    made = []
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        settings = Settings(data=tmp_path / name, server_lost_after_s=0.5)
        made.append(Membership(database, settings, host=name))
    first, second = made
    second.beat()
    with database.write() as connection:
        connection.execute(text("UPDATE servers SET expires_at = expires_at + 600, beat_at = beat_at + 600"))

    def is_alone() -> bool:
        first.beat()
        return not first.is_alive(second.id)

    first.beat()
    assert first.is_alive(second.id)
    wait_until(is_alone, timeout_s=5.0)
    for each in made:
        each.close()


def test_a_leader_that_ends_need_not_be_waited_for(database: Database):
    first, second = (Leadership(database, name, 60.0) for name in ("a", "b"))
    assert first.beat()
    first.release()
    assert not first.is_held
    assert second.beat()
    # The one that ended before must not take the lead from the next.
    first.release()
    assert second.beat()


def test_a_server_whose_work_is_stuck_lets_another_lead(database: Database, tmp_path: Path):
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
    first, second = (Membership(database, Settings(data=tmp_path / name), host="here") for name in ("a", "b"))
    first.beat()
    second.beat()
    assert (first.leads, second.leads) == (True, False)
    first.is_fit = lambda: False
    first.beat()
    second.beat()
    assert (first.leads, second.leads) == (False, True)
    for each in (first, second):
        each.close()


def test_servers_know_where_the_others_are_and_which_of_them_live(database: Database, tmp_path: Path):
    given = {"server_lost_after_s": 1.0}
    made = []
    for name, host in (("a", "one"), ("b", "one"), ("c", "two")):
        (tmp_path / name).mkdir()
        endpoints = (f"unix:/{name}", f"tls:{name}:1")
        settings = Settings(data=tmp_path / name, **given)
        made.append(Membership(database, settings, host=host, endpoints=endpoints, gpus=lambda: 2))
    first, second, third = made
    for each in (*made, *made):
        each.beat()
    assert first.endpoints("one")[:2] == ["unix:/a", "tls:a:1"]
    assert set(first.endpoints("one")) == {"unix:/a", "tls:a:1", "unix:/b", "tls:b:1", "tls:c:1"}
    assert set(first.endpoints("two")) == {"tls:a:1", "tls:b:1", "unix:/c", "tls:c:1"}
    assert first.is_alive(third.id)

    def is_alone() -> bool:
        # All the time: a server that was cut off takes others for dead only later.
        first.beat()
        return not (first.is_alive(second.id) or first.is_alive(third.id))

    began = time.monotonic()
    wait_until(is_alone)
    assert time.monotonic() - began > 0.5
    assert first.is_alive(first.id)
    assert first.endpoints("two") == ["tls:a:1"]
    with database.read() as connection:
        assert {each.id: each.is_alive for each in members(connection)} == {
            first.id: True,
            second.id: False,
            third.id: False,
        }
    for each in made:
        each.close()


def test_secrets_are_made_once_for_all_servers(database: Database, tmp_path: Path):
    folders = [tmp_path / name for name in ("a", "b")]
    for folder in folders:
        folder.mkdir()
    first, second = (
        shared_secret(database, Settings(data=folder, database="x"), WORKER) for folder in folders
    )
    assert first == second
    assert shared_secret(database, Settings(data=folders[0]), SHARE) != first
    assert [path.name for path in folders[0].iterdir()] == []


def test_a_copy_of_a_data_folder_is_noticed_and_an_earlier_life_is_waited_for(
    database: Database, tmp_path: Path
):
    given = Settings(data=tmp_path, server_beat_s=0.1, server_lost_after_s=1.0)
    first = Membership(database, given, host="one", endpoints=("unix:/a/worker.sock",))
    copy = Membership(database, given, host="two", endpoints=("unix:/a/worker.sock",))
    again = Membership(database, given, host="one", endpoints=("unix:/a/worker.sock",))
    assert not first.is_taken()
    first.start("http://x")
    assert copy.is_taken()
    assert not again.is_taken()
    first._stopping.set()
    began = time.monotonic()
    assert not copy.is_taken()
    assert time.monotonic() - began > 0.5
    for each in (first, copy, again):
        each.close()
