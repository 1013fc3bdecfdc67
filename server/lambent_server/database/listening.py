"""Listening for the changes that other servers on the database announce (PostgreSQL's LISTEN).

Nothing depends on an announcement: whoever waits for one also looks at the rows once per second.
"""

import asyncio
import secrets
from collections.abc import Callable

import structlog
from psycopg import AsyncConnection, Error
from sqlalchemy.engine import make_url
from sqlalchemy.exc import SQLAlchemyError

from lambent_server.database.engine import CHANNEL, Database, announce

log = structlog.get_logger()

FIRST_PAUSE_S = 0.5
LONGEST_PAUSE_S = 30.0
# An announcement takes milliseconds, unless the listening connection cannot hear it.
HEARD_WITHIN_S = 5.0
# How often a silent connection is checked.
CHECK_S = 60.0


class Listener:
    """One connection that listens for announcements, for the whole process."""

    def __init__(self, url: str, database: Database, signal: Callable[[], None]) -> None:
        """Listen on `url` and call `signal` at every announcement; `database` is used to test the way."""
        self._conninfo = make_url(url).set(drivername="postgresql").render_as_string(hide_password=False)
        self._database = database
        self._signal = signal
        self.listening = False
        """Whether announcements arrive at present."""

    async def run(self) -> None:
        """Listen until cancelled, and connect again whenever the connection is lost.

        Returns if announcements do not arrive, as behind a pooler that changes connections between
        transactions; then only polling is left.
        """
        pause_s = FIRST_PAUSE_S
        while True:
            try:
                async with await self._connect() as connection:
                    await connection.execute(f"LISTEN {CHANNEL}")
                    if not await self._is_heard(connection):
                        log.warning(
                            "announcements_not_heard",
                            fix="set LAMBENT_DATABASE_DIRECT to the address of PostgreSQL itself; "
                            "until then, changes by other servers are noticed within a second",
                        )
                        return
                    self.listening, pause_s = True, FIRST_PAUSE_S
                    log.info("listening_for_changes")
                    # For what was announced while nobody listened.
                    self._signal()
                    await self._listen(connection)
            except (Error, SQLAlchemyError, OSError) as error:
                log.warning("listening_failed", error=type(error).__name__, retry_after_s=pause_s)
            finally:
                self.listening = False
            await asyncio.sleep(pause_s)
            pause_s = min(2.0 * pause_s, LONGEST_PAUSE_S)

    async def _connect(self) -> AsyncConnection:
        return await AsyncConnection.connect(
            self._conninfo,
            autocommit=True,
            connect_timeout=10,
            application_name="lambent listener",
            keepalives_idle=30,
            keepalives_interval=10,
            keepalives_count=3,
        )

    async def _is_heard(self, connection: AsyncConnection) -> bool:
        """Return whether an announcement from a connection of the database reaches this one."""
        token = secrets.token_hex(8)
        await asyncio.to_thread(self._announce, token)
        async for notice in connection.notifies(timeout=HEARD_WITHIN_S):
            if notice.payload == token:
                return True
        return False

    def _announce(self, token: str) -> None:
        with self._database.write() as connection:
            announce(connection, token)

    async def _listen(self, connection: AsyncConnection) -> None:
        while True:
            async for _ in connection.notifies(timeout=CHECK_S):
                self._signal()
            await connection.execute("SELECT 1")
