"""Errors that say that the database or the store takes no changes just now, and will later."""

import errno

import structlog
from sqlalchemy.exc import DBAPIError, InterfaceError, OperationalError, PendingRollbackError
from sqlalchemy.exc import TimeoutError as PoolTimeoutError

from lambent_server.api.problems import Problem
from lambent_server.database.engine import is_read_only
from lambent_server.storage.s3 import StoreUnavailableError

log = structlog.get_logger()

RETRY_AFTER_S = 5
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
