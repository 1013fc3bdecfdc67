"""Connections: SQLite (write-ahead log, one writer) or PostgreSQL."""

import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import quote

from sqlalchemy import Connection, Engine, ExceptionContext, create_engine, event, func, select, text
from sqlalchemy.engine import make_url
from sqlalchemy.exc import DBAPIError

from lambent_server.database.creation import create_tables
from lambent_server.database.revision import (
    is_served_by_newer,
    revision_of_file,
    revision_of_tables,
)

BUSY_MS = 30_000
ANALYZED_ROWS = 1000
MIGRATIONS = Path(__file__).parent / "migrations"
_MIGRATION_LOCK = 0x1A4BE49
_READ_ONLY_STATE = "25006"
READ_ONLY = "read-only"
CHANNEL = "lambent_changes"


def is_read_only(error: DBAPIError) -> bool:
    """Return whether an error says that the database accepts no changes, as a standby does."""
    state, number = getattr(error.orig, "sqlstate", None), getattr(error.orig, "sqlite_errorcode", 0)
    return state == _READ_ONLY_STATE or number & 0xFF == sqlite3.SQLITE_READONLY


class Database:
    """The engine and the ways to use it: `read`, `snapshot` and `write`."""

    def __init__(self, url: str, *, pooled: bool = False) -> None:
        """Prepare; with `pooled`, each transaction may get another connection (pgbouncer)."""
        self.url = make_url(url)
        self.is_sqlite = self.url.get_backend_name() == "sqlite"
        if self.is_sqlite:
            self.engine = _sqlite(url)
        else:
            # A statement that was prepared on one connection is unknown on the next.
            arguments = {"prepare_threshold": None} if pooled else {}
            self.engine = create_engine(
                url, pool_size=20, max_overflow=20, pool_pre_ping=True, connect_args=arguments
            )
            # After a failover the address may lead to another server, but these connections to the old one.
            event.listen(self.engine, "handle_error", _leave_read_only)

    @contextmanager
    def read(self) -> Iterator[Connection]:
        """Open a transaction that changes nothing."""
        with self.engine.connect() as connection:
            yield connection

    @contextmanager
    def snapshot(self) -> Iterator[Connection]:
        """Open a transaction that changes nothing, and whose statements all see the same state."""
        # A transaction of SQLite always does.
        options = {} if self.is_sqlite else {"isolation_level": "REPEATABLE READ"}
        with self.engine.connect().execution_options(**options) as connection:
            yield connection

    @contextmanager
    def write(self) -> Iterator[Connection]:
        """Open a transaction that is committed at the end, or rolled back by an exception."""
        with self.engine.connect().execution_options(lambent_write=True) as connection, connection.begin():
            yield connection

    def probe(self, timeout_s: float) -> str:
        """Return "ok" if the database accepts a write, "locked" if it does not within `timeout_s`.

        "read-only" is a standby, or a database that an operator has closed to changes. Raises the driver's
        exception if the database is unavailable.
        """
        if not self.is_sqlite:
            with self.read() as connection:
                closed = connection.execute(text("SELECT current_setting('transaction_read_only')")).scalar()
                if closed == "on":
                    connection.invalidate()
                    return READ_ONLY
            return "ok"
        # Not from the pool, whose connections may all be waiting for the lock.
        uri = f"file:{quote(str(self.url.database))}?mode=rw"
        with closing(sqlite3.connect(uri, uri=True, timeout=timeout_s, isolation_level=None)) as raw:
            try:
                raw.execute("BEGIN IMMEDIATE")
                # Only a statement that writes notices that the file is read-only.
                raw.execute("DELETE FROM alembic_version WHERE 0")
                raw.execute("ROLLBACK")
            except sqlite3.OperationalError as error:
                if error.sqlite_errorcode == sqlite3.SQLITE_BUSY:
                    return "locked"
                if error.sqlite_errorcode & 0xFF == sqlite3.SQLITE_READONLY:
                    return READ_ONLY
                raise
        return "ok"

    def revision(self) -> str | None:
        """Return the revision of the tables, None if there are none; not a byte of a file changes."""
        if self.is_sqlite:
            return revision_of_file(Path(self.url.database or ""))
        with self.read() as connection:
            return revision_of_tables(connection)

    def migrate(self) -> None:
        """Create the tables, or migrate them to the version of this code, while no other server does.

        Tables of a newer version are left as they are if they say that they serve this one too; else raises
        SchemaTooNewError.
        """
        # Alembic is needed only briefly at startup, and is slow to import.
        from alembic import command
        from alembic.config import Config
        from alembic.migration import MigrationContext
        from alembic.script import ScriptDirectory

        config = Config()
        config.set_main_option("script_location", str(MIGRATIONS))
        scripts = ScriptDirectory.from_config(config)
        head = str(scripts.get_current_head())
        with self._migrating(), self.engine.connect() as connection:
            current = revision_of_tables(connection)
            if current is None:
                with self.write() as writing:
                    create_tables(writing, head)
                    MigrationContext.configure(writing).stamp(scripts, head)
                return
            if is_served_by_newer(connection, current, head):
                return
            # That question has begun a transaction, and each migration has one of its own.
            connection.rollback()
            config.attributes["connection"] = connection
            command.upgrade(config, "head")

    @contextmanager
    def _migrating(self) -> Iterator[None]:
        """Keep other servers from migrating; the lock is one of a transaction, which poolers leave alone."""
        if self.is_sqlite:
            yield
            return
        with self.engine.connect() as connection, connection.begin():
            connection.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": _MIGRATION_LOCK})
            yield

    def analyze(self) -> None:
        """Tell SQLite what its indexes hold, from samples; PostgreSQL finds out by itself.

        Otherwise it takes every condition to be as good as any other: one that all rows fulfil, their tenant,
        as good as the job.
        """
        if self.is_sqlite:
            with self.write() as connection:
                connection.exec_driver_sql(f"PRAGMA analysis_limit = {ANALYZED_ROWS}")
                connection.exec_driver_sql("ANALYZE")

    def close(self) -> None:
        """Close every connection."""
        self.engine.dispose()


def announce(connection: Connection, payload: str = "") -> None:
    """Announce a change of jobs to every server when the transaction commits; once, however often called."""
    if connection.dialect.name == "postgresql":
        connection.execute(select(func.pg_notify(CHANNEL, payload)))


def _leave_read_only(context: ExceptionContext) -> None:
    """Let the pool connect anew after a refused change, as it does after a broken connection."""
    error = context.sqlalchemy_exception
    if isinstance(error, DBAPIError) and is_read_only(error):
        context.is_disconnect = True


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
