"""Time as a process lives through it, and as servers write it, whatever is done to their clocks."""

import time
from dataclasses import dataclass

import pytest
from lambent_server.core import clock
from lambent_server.core.clock import LONGEST_LEAD_S, LivedTime, SteadyTime


@dataclass
class Clocks:
    """The clocks of the machine, as the test sets them."""

    wall: float = 1_000_000_000.0
    monotonic: float = 100.0

    def pass_on(self, seconds: float, *, jump: float = 0.0) -> None:
        self.wall += seconds + jump
        self.monotonic += seconds


@pytest.fixture
def clocks(monkeypatch: pytest.MonkeyPatch) -> Clocks:
    clocks = Clocks()
    monkeypatch.setattr(time, "time", lambda: clocks.wall)
    monkeypatch.setattr(time, "monotonic", lambda: clocks.monotonic)
    return clocks


def test_of_a_long_pause_only_the_longest_that_is_usual_counts(monkeypatch: pytest.MonkeyPatch):
    at = 100.0
    monkeypatch.setattr(time, "monotonic", lambda: at)
    lived = LivedTime(5.0)
    for pause in (2.0, 3600.0, 5.0):
        at += pause
        lived.pass_on()
    assert lived.seconds == 2.0 + 5.0 + 5.0


@pytest.mark.parametrize("jump", [-2.0, -600.0, -80_000.0])
def test_time_runs_on_when_the_clock_is_set_back_and_meets_it_again(clocks: Clocks, jump: float):
    steady = SteadyTime()
    before = steady.now()
    clocks.pass_on(1.0, jump=jump)
    assert steady.now() == pytest.approx(before + 0.9)
    for _ in range(5):
        last = steady.now()
        clocks.pass_on(10.0)
        assert last + 8.9 < steady.now() < last + 10.1
    clocks.pass_on(-11 * jump)
    assert steady.now() == clocks.wall


def test_a_clock_that_is_set_back_by_more_than_a_day_is_followed(clocks: Clocks):
    steady = SteadyTime()
    clocks.pass_on(1.0, jump=-LONGEST_LEAD_S - 10.0)
    assert steady.now() == clocks.wall


def test_a_clock_that_is_set_forward_is_followed_and_what_it_skipped_is_known(clocks: Clocks):
    steady = SteadyTime()
    clocks.pass_on(1.0, jump=600.0)
    assert steady.now() == clocks.wall
    assert steady.skipped_s(60.0) == pytest.approx(600.0)
    clocks.pass_on(61.0)
    assert steady.skipped_s(60.0) == 0.0


def test_a_new_server_does_not_begin_before_what_its_database_holds(clocks: Clocks):
    steady = SteadyTime()
    steady.begin(None, clocks.wall + 600.0)
    assert steady.now() == pytest.approx(clocks.wall + 600.0)
    steady.begin(None, clocks.wall + LONGEST_LEAD_S + 600.0)
    assert steady.now() == clocks.wall


def test_servers_on_one_database_write_its_time_whatever_their_own_clocks_show(clocks: Clocks):
    first, second = SteadyTime(), SteadyTime()
    database = clocks.wall + 12_345.0
    first.begin(database, 0.0)
    clocks.wall -= 300.0
    second.begin(database, 0.0)
    assert first.now() == second.now() == database
    clocks.pass_on(2.0, jump=77.0)
    assert first.now() == second.now() == pytest.approx(database + 2.0)
    for each in (first, second):
        each.follow(database - 600.0)
        assert each.now() == pytest.approx(database + 2.0)


def test_ids_sort_by_when_they_were_made_and_tell_it(clocks: Clocks, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(clock, "now", SteadyTime().now)
    ids = []
    for jump in (0.0, -600.0, 600.0, -5.0):
        clocks.pass_on(0.01, jump=jump)
        ids.append(clock.new_id("job"))
    assert ids == sorted(ids)
    assert clock.time_of_id(ids[0]) == pytest.approx(1_000_000_000.01, abs=2e-3)
    assert clock.time_of_id("key_test") == clock.time_of_id("") == 0.0
