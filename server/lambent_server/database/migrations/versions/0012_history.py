"""Indexes so that nothing takes longer the more jobs have ended, and counts of jobs by tenant and state.

Servers of the release before go on working meanwhile and afterwards: tables and indexes are only added, apart
from three indexes whose queries the new ones serve; and triggers count what such servers do too. PostgreSQL:
reads go on, and writes wait while the indexes are built.
"""

import sqlalchemy as sa
import structlog
from alembic import op
from lambent_server.database.migration_locks import lock

log = structlog.get_logger()

revision = "0012"
down_revision = "0011"

_QUEUED = "state = 'queued' AND handle IS NULL"
_OBSERVED = "state IN ('running', 'cancelling') OR handle IS NOT NULL"

_INDEXES: tuple[tuple[str, str, list[str]], ...] = (
    ("ix_jobs_tenant_id_kind_id", "jobs", ["tenant_id", "kind", "id"]),
    ("ix_jobs_tenant_id_kind_state_id", "jobs", ["tenant_id", "kind", "state", "id"]),
    ("ix_jobs_scene_id_id", "jobs", ["scene_id", "id"]),
    ("ix_jobs_tenant_id_preset_id", "jobs", ["tenant_id", "preset", "id"]),
    ("ix_job_labels_tenant_id_name_value_job_id", "job_labels", ["tenant_id", "name", "value", "job_id"]),
    ("ix_render_orders_tenant_id_kind_id", "render_orders", ["tenant_id", "kind", "id"]),
    ("ix_scenes_tenant_id_id", "scenes", ["tenant_id", "id"]),
    ("ix_bundles_tenant_id_id", "bundles", ["tenant_id", "id"]),
    ("ix_environments_tenant_id_id", "environments", ["tenant_id", "id"]),
    ("ix_sessions_expires_at", "sessions", ["expires_at"]),
    ("ix_shares_expires_at", "shares", ["expires_at"]),
    ("ix_garbage_at", "garbage", ["at"]),
    ("ix_idempotency_keys_tenant_id_job_id", "idempotency_keys", ["tenant_id", "job_id"]),
    ("ix_idempotency_keys_created_at", "idempotency_keys", ["created_at"]),
)
_PARTIAL: tuple[tuple[str, str, list[str], str], ...] = (
    ("ix_jobs_observed", "jobs", ["id"], _OBSERVED),
    ("ix_jobs_queue", "jobs", ["gpus", "priority", "tenant_id", "id"], _QUEUED),
    ("ix_jobs_due", "jobs", ["retry_at"], "state = 'retry_wait'"),
    ("ix_jobs_queued_since", "jobs", ["created_at"], "state = 'queued'"),
    ("ix_scenes_open", "scenes", ["created_at"], "state = 'open'"),
)
# The indexes above serve the same queries.
_COVERED: tuple[tuple[str, str, list[str]], ...] = (
    ("ix_jobs_state", "jobs", ["state"]),
    ("ix_jobs_scene_id", "jobs", ["scene_id"]),
    ("ix_job_labels_tenant_id_name_value", "job_labels", ["tenant_id", "name", "value"]),
)

_SQLITE = (
    """
    CREATE TRIGGER jobs_count_added AFTER INSERT ON jobs BEGIN
        INSERT INTO job_counts (tenant_id, state, num_jobs) VALUES (NEW.tenant_id, NEW.state, 1);
    END
    """,
    """
    CREATE TRIGGER jobs_count_moved AFTER UPDATE OF state ON jobs WHEN OLD.state <> NEW.state BEGIN
        INSERT INTO job_counts (tenant_id, state, num_jobs)
        VALUES (OLD.tenant_id, OLD.state, -1), (NEW.tenant_id, NEW.state, 1);
    END
    """,
    """
    CREATE TRIGGER jobs_count_removed AFTER DELETE ON jobs BEGIN
        INSERT INTO job_counts (tenant_id, state, num_jobs) VALUES (OLD.tenant_id, OLD.state, -1);
    END
    """,
)
# Jobs are added and removed by the statement, which may be one of a million rows, and moved one by one: a
# trigger for statements would also be called for every heartbeat.
_POSTGRESQL = (
    """
    CREATE FUNCTION jobs_count_added() RETURNS trigger LANGUAGE plpgsql AS $$ BEGIN
        INSERT INTO job_counts (tenant_id, state, num_jobs)
        SELECT tenant_id, state, count(*) FROM added GROUP BY tenant_id, state;
        RETURN NULL;
    END $$
    """,
    """
    CREATE FUNCTION jobs_count_moved() RETURNS trigger LANGUAGE plpgsql AS $$ BEGIN
        INSERT INTO job_counts (tenant_id, state, num_jobs)
        VALUES (OLD.tenant_id, OLD.state, -1), (NEW.tenant_id, NEW.state, 1);
        RETURN NULL;
    END $$
    """,
    """
    CREATE FUNCTION jobs_count_removed() RETURNS trigger LANGUAGE plpgsql AS $$ BEGIN
        INSERT INTO job_counts (tenant_id, state, num_jobs)
        SELECT tenant_id, state, -count(*) FROM removed GROUP BY tenant_id, state;
        RETURN NULL;
    END $$
    """,
    """
    CREATE TRIGGER jobs_count_added AFTER INSERT ON jobs REFERENCING NEW TABLE AS added
    FOR EACH STATEMENT EXECUTE FUNCTION jobs_count_added()
    """,
    """
    CREATE TRIGGER jobs_count_moved AFTER UPDATE OF state ON jobs
    FOR EACH ROW WHEN (OLD.state <> NEW.state) EXECUTE FUNCTION jobs_count_moved()
    """,
    """
    CREATE TRIGGER jobs_count_removed AFTER DELETE ON jobs REFERENCING OLD TABLE AS removed
    FOR EACH STATEMENT EXECUTE FUNCTION jobs_count_removed()
    """,
)


# The names of scenes by their parts of three letters: both databases find them without reading every name.
_SQLITE_NAMES = (
    "CREATE TABLE scene_numbers (number INTEGER PRIMARY KEY, scene_id TEXT NOT NULL UNIQUE)",
    "CREATE VIRTUAL TABLE scene_names USING fts5(name, tokenize = 'trigram')",
    "INSERT INTO scene_numbers (scene_id) SELECT id FROM scenes ORDER BY id",
    """
    INSERT INTO scene_names (rowid, name)
    SELECT number, lower(name) FROM scene_numbers JOIN scenes ON scenes.id = scene_id
    """,
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


def _index_names(statements: tuple[str, ...]) -> None:
    """Index the names, unless the database lacks the extension or the right to it: then it looks at all."""
    try:
        with op.get_bind().begin_nested():
            for statement in statements:
                op.execute(statement)
    except sa.exc.DBAPIError as error:
        log.warning("names_not_indexed", error=str(error.orig))


def upgrade() -> None:
    postgresql = op.get_bind().dialect.name == "postgresql"
    op.create_table(
        "job_counts",
        sa.Column("id", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.Column("tenant_id", sa.Text(), nullable=False),
        sa.Column("state", sa.Text(), nullable=False),
        sa.Column("num_jobs", sa.Integer(), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_job_counts")),
    )
    op.create_index(op.f("ix_job_counts_tenant_id_state"), "job_counts", ["tenant_id", "state"], unique=False)
    lock(tuple(sorted({table for _, table, *_ in (*_INDEXES, *_PARTIAL)})), "SHARE ROW EXCLUSIVE")
    for statement in _POSTGRESQL if postgresql else _SQLITE:
        op.execute(statement)
    op.execute(
        "INSERT INTO job_counts (tenant_id, state, num_jobs) "
        "SELECT tenant_id, state, count(*) FROM jobs GROUP BY tenant_id, state"
    )
    for name, table, columns in _INDEXES:
        op.create_index(op.f(name), table, columns, unique=False)
    for name, table, columns, condition in _PARTIAL:
        where = sa.text(condition)
        op.create_index(op.f(name), table, columns, unique=False, sqlite_where=where, postgresql_where=where)
    _index_names(_POSTGRESQL_NAMES if postgresql else _SQLITE_NAMES)
    lock(tuple(sorted({table for _, table, _ in _COVERED})), "ACCESS EXCLUSIVE")
    for name, table, _ in _COVERED:
        op.drop_index(op.f(name), table_name=table)


def downgrade() -> None:
    postgresql = op.get_bind().dialect.name == "postgresql"
    if postgresql:
        op.execute("DROP INDEX IF EXISTS scene_names")
    else:
        for name in ("added", "changed", "removed"):
            op.execute(f"DROP TRIGGER IF EXISTS scenes_name_{name}")
        for name in ("scene_names", "scene_numbers"):
            op.execute(f"DROP TABLE IF EXISTS {name}")
    for name, table, columns in _COVERED:
        op.create_index(op.f(name), table, columns, unique=False)
    for name, table, *_ in (*_PARTIAL, *_INDEXES):
        op.drop_index(op.f(name), table_name=table)
    for name in ("added", "moved", "removed"):
        op.execute(f"DROP TRIGGER jobs_count_{name}" + (" ON jobs" if postgresql else ""))
        if postgresql:
            op.execute(f"DROP FUNCTION jobs_count_{name}")
    op.drop_table("job_counts")
