"""The election of the one server, of several on a database, that controls the jobs."""

import contextlib

import structlog
from sqlalchemy import Connection, text
from sqlalchemy.exc import SQLAlchemyError

from lambent_server.database.engine import Database

log = structlog.get_logger()

_LOCK = 0x1A4BE47


class Leadership:
    """A lock that ends with the connection that holds it.

    PostgreSQL: an advisory lock; it may be lost at any time together with the connection, so it is checked
    before every round. SQLite: the lock on the data folder already decides.
    """

    def __init__(self, database: Database) -> None:
        self._database = database
        self._connection: Connection | None = None
        self._held = database.is_sqlite

    def held(self) -> bool:
        """Return whether this process controls the jobs now, taking the lock if it is free."""
        if self._database.is_sqlite:
            return True
        before = self._held
        self._held = self._still_held() or self._take()
        if self._held != before:
            log.info("leadership", held=self._held)
        return self._held

    def _still_held(self) -> bool:
        if not self._held or self._connection is None:
            return False
        try:
            self._connection.execute(text("SELECT 1"))
        except SQLAlchemyError:
            self.close()
            return False
        return True

    def _take(self) -> bool:
        if self._connection is None:
            connection = self._database.engine.connect()
            self._connection = connection.execution_options(isolation_level="AUTOCOMMIT")
        try:
            statement = text("SELECT pg_try_advisory_lock(:key)")
            return bool(self._connection.execute(statement, {"key": _LOCK}).scalar())
        except SQLAlchemyError:
            self.close()
            raise

    def close(self) -> None:
        """Release the lock."""
        if self._connection is not None:
            with contextlib.suppress(SQLAlchemyError):
                # Not back to the pool: the next user would hold the lock without knowing.
                self._connection.invalidate()
                self._connection.close()
            self._connection = None
        self._held = self._database.is_sqlite
