"""Notices of operators to every server on a database: start no runs (drain), accept no writes."""

import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass

from sqlalchemy import Connection, delete

from lambent_server.core.clock import now
from lambent_server.database.engine import Database
from lambent_server.database.service_schema import server_state
from lambent_server.database.tenancy import across_tenants

DRAIN = "drain"
MAINTENANCE = "maintenance"
CACHED_S = 1.0
DEFAULT_RETRY_AFTER_S = 60


@dataclass(frozen=True, kw_only=True, slots=True)
class Notice:
    """One thing that operators have told."""

    since: float
    message: str
    retry_after_s: int


def announce(
    connection: Connection, name: str, message: str = "", retry_after_s: int = DEFAULT_RETRY_AFTER_S
) -> None:
    """Give a notice to all servers; one that exists keeps its time."""
    before = read(connection).get(name)
    withdraw(connection, name)
    values = {"since": before.since if before else now(), "message": message, "retry_after_s": retry_after_s}
    connection.execute(server_state.insert().values(name=name, **values))


def withdraw(connection: Connection, name: str) -> None:
    """Tell all servers that this is over."""
    connection.execute(delete(server_state).where(server_state.c.name == name))


def read(connection: Connection) -> dict[str, Notice]:
    """Return what holds now, by name."""
    notices = connection.execute(across_tenants(server_state))
    return {
        row.name: Notice(since=row.since, message=row.message, retry_after_s=row.retry_after_s)
        for row in notices
    }


class Notices:
    """What holds, as of at most a second ago."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._lock = threading.Lock()
        self._known: Mapping[str, Notice] = {}
        self._until = 0.0

    def known(self) -> Mapping[str, Notice] | None:
        """Return what holds, by name, without waiting; None if only the database knows."""
        return self._known if time.monotonic() < self._until else None

    def now(self) -> Mapping[str, Notice]:
        """Return what holds, by name."""
        with self._lock:
            if time.monotonic() >= self._until:
                with self._database.read() as connection:
                    self._known = read(connection)
                self._until = time.monotonic() + CACHED_S
            return self._known
