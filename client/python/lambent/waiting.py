"""Waiting for a job or batch to end, for at most a given time."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

from lambent.errors import ServerFaultError, UnreachableError, WaitTimeoutError
from lambent.models import Batch, Job
from lambent.watch import PATIENCE_S

T = TypeVar("T", Job, Batch)

LONG_S = 30.0
"""How long the server may take to say that nothing has ended, where nobody wants to see the progress."""

ANSWER_S = 10.0
"""How long an answer may take beyond the time that the server was given."""

SHORT_S = 1.0
"""The same where the progress is shown, and the pause between questions that are answered at once."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Wait(Generic[T]):
    """One wait. `timeout_s` None waits for ever; `progress` gets every state that differs from the last."""

    read: Callable[[float], T]
    """Returns the state; may take as many seconds as given if nothing has ended."""
    timeout_s: float | None
    progress: Callable[[T], None] | None
    sleep: Callable[[float], None]
    clock: Callable[[], float]

    def until_final(self) -> T:
        """Return the final state.

        Raises WaitTimeoutError (`client.wait_timeout`), after which the server continues its work, and
        UnreachableError when the server has been unavailable for `PATIENCE_S`.
        """
        began = last_contact = self.clock()
        known: T | None = None
        while True:
            asked = self.clock()
            left_s = self._left_s(asked - began)
            try:
                newest = self.read(min(left_s, LONG_S if self.progress is None else SHORT_S))
                last_contact = self.clock()
                if self.progress is not None and newest != known:
                    self.progress(newest)
                known = newest
                if newest.is_final:
                    return newest
            except (UnreachableError, ServerFaultError):
                if self.clock() - last_contact > PATIENCE_S:
                    raise
            now = self.clock()
            left_s = self._left_s(now - began)
            if left_s <= 0.0:
                raise _timed_out(known, self.timeout_s)
            # Not all servers and proxies take their time.
            self.sleep(min(max(SHORT_S - (now - asked), 0.0), left_s))

    def _left_s(self, passed_s: float) -> float:
        return LONG_S if self.timeout_s is None else self.timeout_s - passed_s


def _timed_out(last: Job | Batch | None, timeout_s: float | None) -> WaitTimeoutError:
    """Return the error of a wait whose time is over."""
    if last is None:
        return WaitTimeoutError(
            "client.wait_timeout",
            f"the server did not answer for {timeout_s:g} s",
            "check it with `lambent doctor`, and wait again",
        )
    kind = "job" if isinstance(last, Job) else "batch"
    shown = f"{kind} {last.id} is {last.state} after {timeout_s:g} s"
    if isinstance(last, Job) and last.progress.stage:
        shown += f" ({last.progress.stage}, {last.progress.fraction:.0%})"
    return WaitTimeoutError("client.wait_timeout", shown, "it has not been stopped: wait again, or cancel it")
