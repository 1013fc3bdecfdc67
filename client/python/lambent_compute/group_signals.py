"""Signals that a terminal or a supervisor sends to a whole group of processes, kept from helpers in it.

Ctrl-C reaches every process that a command has started. What happens then is the command's decision: to end
after a step, with a checkpoint, to which its helpers still contribute.
"""

import signal
from collections.abc import Iterator
from contextlib import contextmanager

GROUP_SIGNALS = ("SIGINT", "SIGTERM", "SIGHUP")
"""Signals that are sent to groups; not all systems have all of them."""


@contextmanager
def held_back(*names: str) -> Iterator[None]:
    """Return a context in which processes are started that do not receive the signals of these names.

    They inherit that the signals are blocked, so that none ends them before they can decide: an interpreter
    needs seconds to come to its own program. A helper calls `ignore`, or ends without ever having received
    one. A signal that arrives at this process meanwhile is handled when the context ends.
    """
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, _numbers(names))
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def ignore(*names: str) -> None:
    """Ignore the signals of these names from now on, also those that were held back."""
    numbers = _numbers(names)
    for number in numbers:
        signal.signal(number, signal.SIG_IGN)
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, numbers)


def _numbers(names: tuple[str, ...]) -> list[signal.Signals]:
    return [signal.Signals[name] for name in names if hasattr(signal, name)]
