"""One look at the database for all streams of a credential."""

import pytest
from lambent_server.accounts.who import Who
from lambent_server.database.tenancy import Tenant
from lambent_server.http import rechecks
from lambent_server.http.rechecks import Rechecks

READER = Who(tenant=Tenant("studio"), kind="key", id="key_1", scopes=frozenset({"read"}))
OTHER = Who(tenant=Tenant("other"), kind="key", id="key_2", scopes=frozenset({"read"}))


class Clock:
    """A clock that stands until it is moved, and the number of look-ups."""

    def __init__(self) -> None:
        self.at = 100.0
        self.asked = 0
        self.answer: Who | None = READER

    def monotonic(self) -> float:
        return self.at

    def identify(self) -> Who | None:
        self.asked += 1
        self.at += 0.5
        return self.answer


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(rechecks, "time", clock)
    return clock


def test_streams_of_one_credential_ask_once_within_the_time(clock: Clock):
    found = Rechecks(5.0)
    assert [found.who("key a", clock.identify) for _ in range(1000)] == [READER] * 1000
    assert clock.asked == 1


def test_what_was_revoked_is_noticed_once_the_time_since_the_question_is_over(clock: Clock):
    found = Rechecks(5.0)
    found.who("key a", clock.identify)
    clock.answer = None
    clock.at = 104.9
    assert found.who("key a", clock.identify) == READER
    clock.at = 105.1
    assert found.who("key a", clock.identify) is None


def test_nobody_gets_the_answer_of_another_credential(clock: Clock):
    found = Rechecks(5.0)
    assert found.who(("session a", "mallory"), clock.identify) == READER
    clock.answer = OTHER
    assert found.who(("session a", "alice"), clock.identify) == OTHER


def test_a_question_that_fails_is_asked_again(clock: Clock):
    def fail() -> Who | None:
        raise OSError("away")

    found = Rechecks(5.0)
    with pytest.raises(OSError, match="away"):
        found.who("key a", fail)
    assert found.who("key a", clock.identify) == READER


def test_credentials_are_forgotten_before_they_fill_the_memory(clock: Clock, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(rechecks, "_FORGET_ABOVE", 10)
    found = Rechecks(5.0)
    for number in range(100):
        found.who(number, clock.identify)
        clock.at = 100.0
    assert len(found._found) <= 10
