"""Errors that say that the database or the store takes no changes just now, and work that outlives them."""

import errno
import threading
from collections.abc import Callable

import structlog
from sqlalchemy.exc import DBAPIError, InterfaceError, OperationalError, PendingRollbackError, SQLAlchemyError
from sqlalchemy.exc import TimeoutError as PoolTimeoutError

from lambent_server.api.problems import Problem
from lambent_server.database.engine import is_read_only
from lambent_server.storage.s3 import StoreUnavailableError

log = structlog.get_logger()

RETRY_AFTER_S = 5
TICK_S = 60.0
"""Time between two rounds of most work that is never done."""
_DATABASE = (OperationalError, InterfaceError, PendingRollbackError, PoolTimeoutError)
_DISK = frozenset({errno.EROFS, errno.EACCES, errno.EPERM, errno.EIO, errno.ENOSPC, errno.EDQUOT})


def outage_of(error: Exception) -> Problem | None:
    """Return the response to an error that another attempt may not meet; None for others."""
    if isinstance(error, DBAPIError) and is_read_only(error):
        return _later("database_read_only", "the database accepts no changes; it is read-only")
    broken = isinstance(error, DBAPIError) and error.connection_invalidated
    if broken or isinstance(error, _DATABASE):
        return _later("database_unavailable", "the database does not answer")
    if isinstance(error, StoreUnavailableError):
        return _later("store_unavailable", "the store of files does not answer, is read-only or full")
    if isinstance(error, OSError) and error.errno in _DISK:
        return _later("store_unavailable", "the server's disk is read-only or full")
    return None


def report(event: str, error: Exception) -> None:
    """Log what failed: in one line if the database or the store is unavailable, else with a traceback."""
    problem = outage_of(error)
    if problem is None:
        log.error(event, exc_info=error)
    else:
        log.warning(event, reason=problem.code, error=type(error).__name__)


def _later(code: str, detail: str) -> Problem:
    return Problem(503, code, detail, retryable=True, headers={"retry-after": str(RETRY_AFTER_S)})


class Stopped(Exception):  # noqa: N818 (an answer, not a mistake)
    """The server ends."""


class Rounds:
    """Calls `turn` again and again in a thread of its own.

    `turn` returns after how many seconds it is to be called again. During an outage, which is logged as
    `<name>_failed`, the next round comes after `TICK_S` and finds the same work.
    """

    def __init__(self, name: str, turn: Callable[[], float]) -> None:
        self._name = name
        self._turn = turn
        self._stopping = threading.Event()
        self._woken = threading.Event()
        self._thread = threading.Thread(target=self._loop, name=name, daemon=True)
        self.start = self._thread.start
        self.wake = self._woken.set
        """Call `turn` at once."""

    def close(self, timeout_s: float = 5.0) -> None:
        """Stop, if `turn` pauses also in the middle of it."""
        self._stopping.set()
        self._woken.set()
        if self._thread.is_alive():
            self._thread.join(timeout_s)

    def pause(self, seconds: float = 0.0) -> None:
        """Wait; raises Stopped if the server ends meanwhile."""
        if self._stopping.wait(seconds):
            raise Stopped

    def _loop(self) -> None:
        while not self._stopping.is_set():
            try:
                wait_s = self._turn()
            except Stopped:
                return
            except (SQLAlchemyError, OSError) as error:
                report(f"{self._name}_failed", error)
                # New work does not end an outage, and would only fill the log.
                self._stopping.wait(TICK_S)
                continue
            self._woken.wait(wait_s)
            self._woken.clear()
