"""The tables of this version in an empty database: those of `schema`, with triggers and first rows.

Triggers, so that counts and sums are kept whichever server or operator changes the rows.
"""

from dataclasses import dataclass

import structlog
from sqlalchemy import Connection, insert, text
from sqlalchemy.exc import DBAPIError

from lambent_server.database import schema  # noqa: F401 (all tables belong to the metadata)
from lambent_server.database.cluster_schema import leadership, schema_info
from lambent_server.database.columns import clock_time, metadata
from lambent_server.database.people_schema import organisations
from lambent_server.database.tenancy import DEFAULT_TENANT_ID

log = structlog.get_logger()


@dataclass(frozen=True, slots=True)
class Trigger:
    """A trigger of both databases: when it fires, up to the table, and what it does."""

    name: str
    when: str
    body: str
    scope: str = "FOR EACH ROW"
    """How often it fires; only PostgreSQL has several ways, and conditions there."""
    sqlite_when: str = ""
    """Empty: as in PostgreSQL."""
    sqlite_body: str = ""
    returns: str = "NULL"
    """The row if the change is to happen; of no effect after it."""

    def statements(self, *, postgresql: bool) -> tuple[str, ...]:
        """Return what makes the trigger."""
        if not postgresql:
            when, body = self.sqlite_when or self.when, self.sqlite_body or self.body
            return (f"CREATE TRIGGER {self.name} {when} BEGIN {body} END",)
        return (
            f"CREATE FUNCTION {self.name}() RETURNS trigger LANGUAGE plpgsql AS $$ "
            f"BEGIN {self.body} RETURN {self.returns}; END $$",
            f"CREATE TRIGGER {self.name} {self.when} {self.scope} EXECUTE FUNCTION {self.name}()",
        )


_MOVED = """
    INSERT INTO job_counts (tenant_id, state, num_jobs)
    VALUES (OLD.tenant_id, OLD.state, -1), (NEW.tenant_id, NEW.state, 1);
"""
_BYTES_ADDED = """
    INSERT INTO usage_sums (tenant_id, name, amount) VALUES (NEW.tenant_id, 'bytes', NEW.size_bytes)
    ON CONFLICT (tenant_id, name) DO UPDATE SET amount = usage_sums.amount + excluded.amount;
"""
_BYTES_REMOVED = """
    UPDATE usage_sums SET amount = amount - OLD.size_bytes
    WHERE tenant_id = OLD.tenant_id AND name = 'bytes';
    DELETE FROM usage_sums WHERE tenant_id = OLD.tenant_id AND name = 'bytes' AND amount = 0;
"""
_PERMITTED = "EXISTS (SELECT 1 FROM audit_permits WHERE tenant_id = OLD.tenant_id AND up_to >= OLD.number)"
_UNCHANGED = "entries of the audit log are never changed"
_KEPT = "entries of the audit log are removed by retention only"

TRIGGERS = (
    # PostgreSQL: jobs are added and removed by the statement, which may be one of a million rows, and moved
    # one by one: a trigger for statements would also be called for every heartbeat.
    Trigger(
        "jobs_count_added",
        "AFTER INSERT ON jobs REFERENCING NEW TABLE AS added",
        "INSERT INTO job_counts (tenant_id, state, num_jobs) "
        "SELECT tenant_id, state, count(*) FROM added GROUP BY tenant_id, state;",
        "FOR EACH STATEMENT",
        "AFTER INSERT ON jobs",
        "INSERT INTO job_counts (tenant_id, state, num_jobs) VALUES (NEW.tenant_id, NEW.state, 1);",
    ),
    Trigger(
        "jobs_count_moved",
        "AFTER UPDATE OF state ON jobs",
        _MOVED,
        "FOR EACH ROW WHEN (OLD.state <> NEW.state)",
        "AFTER UPDATE OF state ON jobs WHEN OLD.state <> NEW.state",
    ),
    Trigger(
        "jobs_count_removed",
        "AFTER DELETE ON jobs REFERENCING OLD TABLE AS removed",
        "INSERT INTO job_counts (tenant_id, state, num_jobs) "
        "SELECT tenant_id, state, -count(*) FROM removed GROUP BY tenant_id, state;",
        "FOR EACH STATEMENT",
        "AFTER DELETE ON jobs",
        "INSERT INTO job_counts (tenant_id, state, num_jobs) VALUES (OLD.tenant_id, OLD.state, -1);",
    ),
    Trigger("blobs_bytes_added", "AFTER INSERT ON blobs", _BYTES_ADDED),
    Trigger("blobs_bytes_removed", "AFTER DELETE ON blobs", _BYTES_REMOVED),
    Trigger(
        "audit_entries_unchanged",
        "BEFORE UPDATE ON audit_entries",
        f"RAISE EXCEPTION '{_UNCHANGED}';",
        sqlite_body=f"SELECT RAISE(ABORT, '{_UNCHANGED}');",
    ),
    Trigger(
        "audit_entries_kept",
        "BEFORE DELETE ON audit_entries",
        f"IF NOT {_PERMITTED} THEN RAISE EXCEPTION '{_KEPT}'; END IF;",
        sqlite_when=f"BEFORE DELETE ON audit_entries WHEN NOT {_PERMITTED}",
        sqlite_body=f"SELECT RAISE(ABORT, '{_KEPT}');",
        returns="OLD",
    ),
)
_POSTGRESQL = (
    "CREATE TRIGGER audit_entries_whole BEFORE TRUNCATE ON audit_entries "
    "FOR EACH STATEMENT EXECUTE FUNCTION audit_entries_unchanged()",
    "CREATE SEQUENCE checkpoints_number OWNED BY checkpoints.number",
)

# The names of scenes by their parts of three letters: both databases find them without reading every name.
_SQLITE_NAMES = (
    "CREATE TABLE scene_numbers (number INTEGER PRIMARY KEY, scene_id TEXT NOT NULL UNIQUE)",
    "CREATE VIRTUAL TABLE scene_names USING fts5(name, tokenize = 'trigram')",
    """
    CREATE TRIGGER scenes_name_added AFTER INSERT ON scenes BEGIN
        INSERT INTO scene_numbers (scene_id) VALUES (NEW.id);
        INSERT INTO scene_names (rowid, name)
        SELECT number, lower(NEW.name) FROM scene_numbers WHERE scene_id = NEW.id;
    END
    """,
    """
    CREATE TRIGGER scenes_name_changed AFTER UPDATE OF name ON scenes BEGIN
        UPDATE scene_names SET name = lower(NEW.name)
        WHERE rowid = (SELECT number FROM scene_numbers WHERE scene_id = NEW.id);
    END
    """,
    """
    CREATE TRIGGER scenes_name_removed AFTER DELETE ON scenes BEGIN
        DELETE FROM scene_names WHERE rowid = (SELECT number FROM scene_numbers WHERE scene_id = OLD.id);
        DELETE FROM scene_numbers WHERE scene_id = OLD.id;
    END
    """,
)
_POSTGRESQL_NAMES = (
    "CREATE EXTENSION IF NOT EXISTS pg_trgm",
    # Otherwise searches read the names of new scenes one by one, until the next vacuum.
    "CREATE INDEX scene_names ON scenes USING gin (name gin_trgm_ops) WITH (fastupdate = off)",
)


def create_tables(connection: Connection, revision: str) -> None:
    """Create everything; servers from `revision` on can use the tables."""
    postgresql = connection.dialect.name == "postgresql"
    # Tables of this name that exist are those of another program.
    metadata.create_all(connection, checkfirst=False)
    for trigger in TRIGGERS:
        for statement in trigger.statements(postgresql=postgresql):
            connection.execute(text(statement))
    for statement in _POSTGRESQL if postgresql else ():
        connection.execute(text(statement))
    _index_names(connection, _POSTGRESQL_NAMES if postgresql else _SQLITE_NAMES)
    connection.execute(insert(leadership).values(name="leader", holder="", term=0, expires_at=0.0))
    connection.execute(insert(schema_info).values(name="compatible_from", value=revision))
    connection.execute(
        insert(organisations).values(
            tenant_id=DEFAULT_TENANT_ID, name=DEFAULT_TENANT_ID, created_at=clock_time(connection)
        )
    )


def _index_names(connection: Connection, statements: tuple[str, ...]) -> None:
    """Index the names, unless the database lacks the extension or the right to it: then it looks at all."""
    try:
        with connection.begin_nested():
            for statement in statements:
                connection.execute(text(statement))
    except DBAPIError as error:
        log.warning("names_not_indexed", error=str(error.orig))
