"""The other servers of a service, as one of them concludes from their rows; without a database."""

import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from lambent_server.cluster import membership as module
from lambent_server.cluster.membership import PROTOCOL, Member, Membership
from lambent_server.core.settings import Settings
from support.api import opened

THERE = Member(
    id="server_there",
    host="there",
    hostname="render-2",
    url="",
    endpoints=["unix:/there", "tls:there:1"],
    version="1",
    protocol=PROTOCOL,
    slots=1,
    gpus=0,
    started_at=0.0,
    beat_at=0.0,
    expires_at=0.0,
    is_alive=True,
    leads=False,
)


@pytest.fixture
def here(tmp_path: Path) -> Iterator[Membership]:
    with opened(tmp_path / "data") as api:
        settings = Settings(data=tmp_path / "data", server_lost_after_s=15.0)
        yield Membership(api.services.database, settings, host="here", endpoints=("unix:/here",))


def look(here: Membership, monkeypatch: pytest.MonkeyPatch, at: float, *found: Member) -> None:
    """Let a server find these rows at a time."""
    monkeypatch.setattr(module, "members", lambda _: found)
    here._look(at)


def test_runs_are_sent_to_no_server_of_another_protocol(here: Membership, monkeypatch: pytest.MonkeyPatch):
    look(here, monkeypatch, time.monotonic(), THERE)
    assert here.endpoints("elsewhere") == ["tls:there:1"]
    look(here, monkeypatch, time.monotonic(), replace(THERE, protocol=PROTOCOL + 1))
    assert here.endpoints("elsewhere") == []


def test_a_server_that_ends_its_beats_is_dead_at_the_next_look(
    here: Membership, monkeypatch: pytest.MonkeyPatch
):
    at = time.monotonic()
    look(here, monkeypatch, at, THERE)
    assert here.is_alive(THERE.id)
    look(here, monkeypatch, at + 2.0, replace(THERE, is_alive=False))
    assert not here.is_alive(THERE.id)


def test_after_an_outage_of_the_database_those_who_lived_before_have_time_to_say_that_they_live(
    here: Membership, monkeypatch: pytest.MonkeyPatch
):
    before, silent = time.monotonic(), replace(THERE, is_alive=False)
    dead = replace(silent, id="server_dead")
    look(here, monkeypatch, before, THERE, dead)
    # The first to be back finds that nobody has beaten for a minute.
    look(here, monkeypatch, before + 60.0, silent, dead)
    assert here.is_alive(THERE.id)
    assert not here.is_alive(dead.id)
    # Not for longer than any server may be silent, and not if it has left.
    now = time.monotonic()
    monkeypatch.setattr(module.time, "monotonic", lambda: now + 14.0)
    assert here.is_alive(THERE.id)
    look(here, monkeypatch, before + 62.0, dead)
    assert not here.is_alive(THERE.id)
    look(here, monkeypatch, before + 64.0, silent, dead)
    monkeypatch.setattr(module.time, "monotonic", lambda: now + 16.0)
    assert not here.is_alive(THERE.id)


def test_a_server_that_could_not_look_who_lives_controls_nothing(
    here: Membership, monkeypatch: pytest.MonkeyPatch
):
    def away(_: object) -> None:
        raise OSError("away")

    monkeypatch.setattr(module, "members", away)
    here._database.is_sqlite = False
    monkeypatch.setattr(here._leadership, "beat", lambda: pytest.fail("it must not lead"))
    with pytest.raises(OSError, match="away"):
        here.beat()
    assert not here.controls
    here._database.is_sqlite = True
