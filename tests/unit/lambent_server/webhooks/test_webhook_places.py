"""The places of webhooks: a tenant whose receivers hang takes few of them, and others always find one."""

from pathlib import Path

import pytest
from lambent_server.core.settings import Settings
from lambent_server.webhooks.places import FORGET_S, Places


class Clock:
    """A clock that a test moves."""

    at = 1000.0

    def __call__(self) -> float:
        return self.at


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def places(tmp_path: Path, clock: Clock) -> Places:
    settings = Settings(data=tmp_path, webhook_concurrency=16, webhook_per_host=4, webhook_timeout_s=10.0)
    return Places(settings, clock)


def filled(places: Places, tenant: str, host: str = "https://h{}") -> int:
    """Return how many places a tenant gets, each at another host."""
    count = 0
    while places.has_room(tenant):
        places.take(tenant, host.format(count))
        count += 1
    return count


def test_one_tenant_has_half_of_the_places_and_the_last_quarter_is_for_those_without_any(places: Places):
    assert filled(places, "a") == 8
    assert filled(places, "b") == 4
    assert [filled(places, name) for name in "cdef"] == [1, 1, 1, 1]
    assert places.free == 0
    assert filled(places, "g") == 0


def test_every_slow_attempt_halves_the_places_of_a_tenant_and_every_quick_one_gives_one_back(places: Places):
    def most() -> int:
        trial = places.copy()
        return filled(trial, "a")

    found = []
    for seconds, timed_out in [(10.0, True), (6.0, False), (10.0, True), (10.0, True)]:
        places.learn("a", "https://x", seconds=seconds, timed_out=timed_out)
        found.append(most())
    assert found == [4, 2, 1, 1]
    for _ in range(9):
        places.learn("a", "https://x", seconds=0.1, timed_out=False)
        found.append(most())
    assert found[4:] == [2, 3, 4, 5, 6, 7, 8, 8, 8]
    assert filled(places, "b") == 8


def test_tenants_that_are_all_slow_leave_a_quarter_to_one_that_is_not(places: Places):
    for number in range(20):
        for _ in range(3):
            places.learn(f"slow_{number}", "https://x", seconds=10.0, timed_out=True)
    assert sum(filled(places, f"slow_{number}") for number in range(20)) == 12
    assert filled(places, "quick") == 1


def test_a_host_that_one_tenant_has_filled_has_room_for_another(places: Places):
    host = "https://shared.example"
    for _ in range(4):
        assert places.may_reach("a", host)
        places.take("a", host)
    assert not places.may_reach("a", host)
    assert places.full_hosts("a") == [host]
    assert places.may_reach("b", host)
    for _ in range(4):
        places.take("b", host)
    assert not places.may_reach("c", host)
    places.leave("a", host)
    assert places.may_reach("c", host)


def test_a_host_that_timed_out_twice_gets_one_short_attempt_at_a_time_for_a_while(
    places: Places, clock: Clock
):
    host = "https://hangs.example"
    for limit_s in (10.0, 10.0, 2.5):
        assert places.timeout_s("a", host) == limit_s
        places.learn("a", host, seconds=limit_s, timed_out=True)
    assert places.may_reach("a", host)
    places.take("a", host)
    assert not places.may_reach("a", host)
    # The same host may answer another tenant.
    assert places.timeout_s("b", host) == 10.0
    assert places.may_reach("b", host)
    clock.at += FORGET_S
    assert places.timeout_s("a", host) == 10.0
    places.learn("a", host, seconds=1.0, timed_out=False)
    clock.at -= FORGET_S
    assert places.timeout_s("a", host) == 10.0


def test_the_tenant_with_the_fewest_places_is_next_and_then_who_had_one_longest_ago(
    places: Places, clock: Clock
):
    for name in "abb":
        clock.at += 1
        places.take(name, f"https://{name}")
    clock.at += 1
    places.take("c", "https://c")
    assert sorted("abcd", key=places.turn) == ["d", "a", "c", "b"]
