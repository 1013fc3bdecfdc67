"""Time as a process lives through it."""

import time

import pytest
from lambent_server.clock import LivedTime


def test_of_a_long_pause_only_the_longest_that_is_usual_counts(monkeypatch: pytest.MonkeyPatch):
    at = 100.0
    monkeypatch.setattr(time, "monotonic", lambda: at)
    lived = LivedTime(5.0)
    for pause in (2.0, 3600.0, 5.0):
        at += pause
        lived.pass_on()
    assert lived.seconds == 2.0 + 5.0 + 5.0
