"""Connections: SQLite (write-ahead log, one writer) or PostgreSQL."""

import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import quote

from sqlalchemy import Connection, Engine, create_engine, event, text
from sqlalchemy.engine import make_url

BUSY_MS = 30_000


class Database:
    """The engine and the two ways to use it: `read` and `write`."""

    def __init__(self, url: str) -> None:
        self.url = make_url(url)
        self.is_sqlite = self.url.get_backend_name() == "sqlite"
        if self.is_sqlite:
            self.engine = _sqlite(url)
        else:
            self.engine = create_engine(url, pool_size=20, max_overflow=20, pool_pre_ping=True)

    @contextmanager
    def read(self) -> Iterator[Connection]:
        """Open a transaction that changes nothing."""
        with self.engine.connect() as connection:
            yield connection

    @contextmanager
    def write(self) -> Iterator[Connection]:
        """Open a transaction that is committed at the end, or rolled back by an exception."""
        with self.engine.connect().execution_options(lambent_write=True) as connection, connection.begin():
            yield connection

    def probe(self, timeout_s: float) -> str:
        """Return "ok" if the database accepts a write, "locked" if it does not within `timeout_s`.

        Raises the driver's exception if the database is unavailable.
        """
        if not self.is_sqlite:
            with self.read() as connection:
                connection.execute(text("SELECT 1"))
            return "ok"
        # Not from the pool, whose connections may all be waiting for the lock.
        uri = f"file:{quote(str(self.url.database))}?mode=rw"
        with closing(sqlite3.connect(uri, uri=True, timeout=timeout_s, isolation_level=None)) as raw:
            try:
                raw.execute("BEGIN IMMEDIATE")
                raw.execute("ROLLBACK")
            except sqlite3.OperationalError as error:
                if error.sqlite_errorcode == sqlite3.SQLITE_BUSY:
                    return "locked"
                raise
        return "ok"

    def migrate(self) -> None:
        """Migrate the tables to the version of this code."""
        # Alembic is needed only briefly at startup, and is slow to import.
        from alembic import command
        from alembic.config import Config

        config = Config()
        config.set_main_option("script_location", str(Path(__file__).parent / "migrations"))
        with self.engine.connect() as connection, connection.begin():
            config.attributes["connection"] = connection
            command.upgrade(config, "head")

    def close(self) -> None:
        """Close every connection."""
        self.engine.dispose()


def _sqlite(url: str) -> Engine:
    engine = create_engine(url, connect_args={"timeout": BUSY_MS / 1000, "check_same_thread": False})

    @event.listens_for(engine, "connect")
    def prepare(raw: Any, _record: Any) -> None:
        # The driver begins transactions too late to notice other writers; we begin them below.
        raw.isolation_level = None
        cursor = raw.cursor()
        cursor.execute("PRAGMA journal_mode=WAL")
        # A confirmed commit must survive a crash of the machine, not only of the process.
        cursor.execute("PRAGMA synchronous=FULL")
        cursor.execute("PRAGMA foreign_keys=ON")
        cursor.close()
        # SQLite's own knows only ASCII; searches go by it, and PostgreSQL's knows all letters.
        raw.create_function("lower", 1, _lower, deterministic=True)

    @event.listens_for(engine, "begin")
    def begin(connection: Connection) -> None:
        # A writer takes its lock first: upgrading a read transaction later would fail without waiting.
        write = connection.get_execution_options().get("lambent_write", False)
        connection.exec_driver_sql("BEGIN IMMEDIATE" if write else "BEGIN")

    return engine


def _lower(value: Any) -> Any:
    """Return a text in small letters; anything else, NULL among it, as it is.

    Letter by letter, as PostgreSQL does: a sigma at the end of a word is not at the end of a longer one.
    """
    if not isinstance(value, str):
        return value
    return value.lower() if value.isascii() else "".join(letter.lower() for letter in value)
