"""The election of the one server, of several on a database, that does what only one must do.

The leader has a row with an end in time, which it moves on as long as it lives; whoever finds that it has
passed takes the row, and counts the term. Unlike a lock of a session this ends in time also when a machine
vanishes without closing its connections, and it works through a pooler. SQLite: the lock on the data folder
decides, and this server always leads.
"""

import contextlib
import time

import structlog
from sqlalchemy import ColumnElement, Connection, case, false, select, update
from sqlalchemy.exc import SQLAlchemyError

from lambent_server.database.cluster_schema import leadership
from lambent_server.database.columns import clock_time
from lambent_server.database.engine import Database

log = structlog.get_logger()


class Leadership:
    """The lease of one server. `beat` is called by one thread; the others ask `is_held`."""

    def __init__(self, database: Database, holder: str, lease_s: float) -> None:
        self._database = database
        self._holder = holder
        self._lease_s = lease_s
        self._until = 0.0
        self._held = database.is_sqlite
        self._seen: tuple[str, float] | None = None
        """Who led at the last look and until when it had said that, which changes with every beat of it."""
        self._seen_since = 0.0
        self.term = 0
        """Which leader this server is or was, counted from 1."""

    @property
    def is_held(self) -> bool:
        """Whether this server leads now; another one cannot lead before this has become false."""
        return self._database.is_sqlite or time.monotonic() < self._until

    def beat(self) -> bool:
        """Prolong the lease, or take it if nobody has it; return whether this server leads."""
        if self._database.is_sqlite:
            return True
        # Taken before the database adds the lease to its own time: this server's lease ends first, so it has
        # stopped leading before any other server can find the row expired.
        began = time.monotonic()
        mine = leadership.c.holder == self._holder
        with self._database.write() as connection:
            current = clock_time(connection)
            ended = (leadership.c.expires_at < current) | self._is_unchanged(connection, began)
            # One UPDATE decides: of servers that find the lease ended, the lock on the row lets one through,
            # and for the others the condition no longer holds. The term grows with the holder only.
            statement = (
                update(leadership)
                .where(leadership.c.name == "leader", mine | ended)
                .values(
                    holder=self._holder,
                    term=case((mine, leadership.c.term), else_=leadership.c.term + 1),
                    expires_at=current + self._lease_s,
                )
                .returning(leadership.c.term)
            )
            term = connection.execute(statement).scalar_one_or_none()
        held = term is not None
        if held != self._held:
            log.info("leadership", held=held, term=term or self.term)
        self._held = held
        self.term = term or self.term
        self._until = began + self._lease_s if held else 0.0
        return held

    def _is_unchanged(self, connection: Connection, at: float) -> ColumnElement[bool]:
        """Return the condition that the leader was silent for a whole lease, by this server's own clock.

        Its lease has ended then, whatever the database's clock shows, which may have been set back.
        """
        row = select(leadership.c.holder, leadership.c.expires_at).where(leadership.c.name == "leader")
        leader = connection.execute(row).one_or_none()
        seen = None if leader is None else (str(leader[0]), float(leader[1]))
        # Every beat changes `expires_at`, so the same value for a whole lease means that no beat came.
        if seen is None or seen != self._seen:
            self._seen, self._seen_since = seen, at
        if seen is None or at - self._seen_since <= self._lease_s:
            return false()
        # What was seen is part of the condition: a beat between this look and the UPDATE keeps the lease.
        return (leadership.c.holder == seen[0]) & (leadership.c.expires_at == seen[1])

    def release(self) -> None:
        """End the lease now, so that another server takes over at once."""
        if self._database.is_sqlite or not self._held:
            return
        log.info("leadership", held=False, term=self.term)
        # First here, then in the database, whose next leader may begin at once.
        self._until, self._held = 0.0, False
        statement = update(leadership).where(leadership.c.holder == self._holder).values(expires_at=0.0)
        with contextlib.suppress(SQLAlchemyError), self._database.write() as connection:
            connection.execute(statement)
