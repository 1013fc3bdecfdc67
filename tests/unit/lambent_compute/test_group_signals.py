"""Signals to a whole group of processes do not end helpers, however early they come."""

import os
import signal
import subprocess
import sys
import threading

import pytest
from lambent_compute.group_signals import GROUP_SIGNALS, held_back, ignore

SLOW = "import sys; print('here', flush=True); sys.stdin.read(); {then} print('done', flush=True)"
IGNORE = "from lambent_compute.group_signals import *; ignore(*GROUP_SIGNALS);"


def child(then="pass;"):
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen([sys.executable, "-c", SLOW.format(then=then)], **pipes)


@pytest.mark.parametrize("name", GROUP_SIGNALS)
def test_a_signal_that_comes_before_the_program_does_not_end_it(name):
    with held_back(*GROUP_SIGNALS):
        helper = child(then=IGNORE)
    helper.send_signal(signal.Signals[name])
    out, err = helper.communicate("")
    assert (helper.returncode, out, err) == (0, "here\ndone\n", "")


def test_a_signal_that_was_not_named_ends_it():
    with held_back("SIGINT"):
        helper = child()
    helper.send_signal(signal.SIGTERM)
    helper.communicate("")
    assert helper.returncode == -signal.SIGTERM


def test_a_helper_that_ignores_is_not_ended_later_either():
    with held_back(*GROUP_SIGNALS):
        helper = child(then=IGNORE + "import os, signal; os.kill(os.getpid(), signal.SIGTERM);")
    out, _ = helper.communicate("")
    assert (helper.returncode, out) == (0, "here\ndone\n")


def test_a_signal_that_arrives_here_meanwhile_is_handled_afterwards():
    handled = []
    before = signal.signal(signal.SIGINT, lambda *_: handled.append("SIGINT"))
    try:
        with held_back("SIGINT"):
            # To this thread: another one of the process, which does not hold it back, would take it.
            signal.pthread_kill(threading.get_ident(), signal.SIGINT)
            assert handled == []
        assert handled == ["SIGINT"]
    finally:
        signal.signal(signal.SIGINT, before)


def test_what_was_blocked_before_stays_blocked():
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGUSR1])
    try:
        with held_back("SIGINT"):
            assert {signal.SIGINT, signal.SIGUSR1} <= signal.pthread_sigmask(signal.SIG_BLOCK, [])
        assert signal.SIGUSR1 in signal.pthread_sigmask(signal.SIG_BLOCK, [])
        assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, [])
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def test_systems_without_a_mask_or_a_signal_do_without(monkeypatch):
    """Windows has neither."""
    monkeypatch.delattr(signal, "pthread_sigmask")
    monkeypatch.delattr(signal, "SIGHUP")
    before = signal.getsignal(signal.SIGTERM)
    try:
        with held_back(*GROUP_SIGNALS):
            pass
        ignore("SIGTERM", "SIGHUP")
        os.kill(os.getpid(), signal.SIGTERM)
    finally:
        signal.signal(signal.SIGTERM, before)
