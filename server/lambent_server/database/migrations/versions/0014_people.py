"""Organisations, users, scopes of keys, running sums for quotas, the audit log and signed provenance.

Servers of the release before go on working: everything is added, their keys and sessions have all scopes, and
triggers count the bytes that they store too.
"""

import sqlalchemy as sa
from alembic import op
from lambent_server.database.migration_locks import lock

revision = "0014"
down_revision = "0013"

_BIG = sa.BigInteger().with_variant(sa.Integer(), "sqlite")

# A row for each tenant that has one key or blob at least, and always one for the first organisation.
_ORGANISATIONS = """
    INSERT INTO organisations (tenant_id, name, created_at, retention_enforced)
    SELECT tenant_id, tenant_id, {now}, 0 FROM (
        SELECT tenant_id FROM api_keys UNION SELECT tenant_id FROM blobs UNION SELECT 'default'
    ) AS known
"""

_SQLITE = (
    """
    CREATE TRIGGER blobs_bytes_added AFTER INSERT ON blobs BEGIN
        INSERT INTO usage_sums (tenant_id, name, amount) VALUES (NEW.tenant_id, 'bytes', NEW.size_bytes)
        ON CONFLICT (tenant_id, name) DO UPDATE SET amount = amount + excluded.amount;
    END
    """,
    """
    CREATE TRIGGER blobs_bytes_removed AFTER DELETE ON blobs BEGIN
        UPDATE usage_sums SET amount = amount - OLD.size_bytes
        WHERE tenant_id = OLD.tenant_id AND name = 'bytes';
        DELETE FROM usage_sums WHERE tenant_id = OLD.tenant_id AND name = 'bytes' AND amount = 0;
    END
    """,
    """
    CREATE TRIGGER audit_entries_unchanged BEFORE UPDATE ON audit_entries BEGIN
        SELECT RAISE(ABORT, 'entries of the audit log are never changed');
    END
    """,
    """
    CREATE TRIGGER audit_entries_kept BEFORE DELETE ON audit_entries
    WHEN NOT EXISTS (
        SELECT 1 FROM audit_permits WHERE tenant_id = OLD.tenant_id AND up_to >= OLD.number
    ) BEGIN
        SELECT RAISE(ABORT, 'entries of the audit log are removed by retention only');
    END
    """,
)
_POSTGRESQL = (
    """
    CREATE FUNCTION blobs_bytes_added() RETURNS trigger LANGUAGE plpgsql AS $$ BEGIN
        INSERT INTO usage_sums AS sums (tenant_id, name, amount)
        VALUES (NEW.tenant_id, 'bytes', NEW.size_bytes)
        ON CONFLICT (tenant_id, name) DO UPDATE SET amount = sums.amount + excluded.amount;
        RETURN NULL;
    END $$
    """,
    """
    CREATE FUNCTION blobs_bytes_removed() RETURNS trigger LANGUAGE plpgsql AS $$ BEGIN
        UPDATE usage_sums SET amount = amount - OLD.size_bytes
        WHERE tenant_id = OLD.tenant_id AND name = 'bytes';
        DELETE FROM usage_sums WHERE tenant_id = OLD.tenant_id AND name = 'bytes' AND amount = 0;
        RETURN NULL;
    END $$
    """,
    """
    CREATE FUNCTION audit_entries_unchanged() RETURNS trigger LANGUAGE plpgsql AS $$ BEGIN
        RAISE EXCEPTION 'entries of the audit log are never changed';
    END $$
    """,
    """
    CREATE FUNCTION audit_entries_kept() RETURNS trigger LANGUAGE plpgsql AS $$ BEGIN
        IF NOT EXISTS (
            SELECT 1 FROM audit_permits WHERE tenant_id = OLD.tenant_id AND up_to >= OLD.number
        ) THEN
            RAISE EXCEPTION 'entries of the audit log are removed by retention only';
        END IF;
        RETURN OLD;
    END $$
    """,
    """
    CREATE TRIGGER blobs_bytes_added AFTER INSERT ON blobs
    FOR EACH ROW EXECUTE FUNCTION blobs_bytes_added()
    """,
    """
    CREATE TRIGGER blobs_bytes_removed AFTER DELETE ON blobs
    FOR EACH ROW EXECUTE FUNCTION blobs_bytes_removed()
    """,
    """
    CREATE TRIGGER audit_entries_unchanged BEFORE UPDATE ON audit_entries
    FOR EACH ROW EXECUTE FUNCTION audit_entries_unchanged()
    """,
    """
    CREATE TRIGGER audit_entries_whole BEFORE TRUNCATE ON audit_entries
    FOR EACH STATEMENT EXECUTE FUNCTION audit_entries_unchanged()
    """,
    """
    CREATE TRIGGER audit_entries_kept BEFORE DELETE ON audit_entries
    FOR EACH ROW EXECUTE FUNCTION audit_entries_kept()
    """,
)
_TABLES = (
    "provenance_statements",
    "audit_permits",
    "audit_heads",
    "audit_entries",
    "usage_sums",
    "sign_ins",
    "members",
    "users",
    "organisations",
)


def _text(name: str, *, optional: bool = False) -> sa.Column[str]:
    return sa.Column(name, sa.Text(), nullable=optional)


def _time(name: str, *, optional: bool = False) -> sa.Column[float]:
    return sa.Column(name, sa.Double(), nullable=optional)


def _key(table: str, *columns: str) -> sa.PrimaryKeyConstraint:
    return sa.PrimaryKeyConstraint(*columns, name=op.f(f"pk_{table}"))


def _index(table: str, *columns: str) -> None:
    op.create_index(op.f(f"ix_{table}_{'_'.join(columns)}"), table, list(columns), unique=False)


def _create_tables() -> None:
    op.create_table(
        "organisations",
        _text("tenant_id"),
        _text("name"),
        _time("created_at"),
        _time("closed_at", optional=True),
        sa.Column("max_bytes", sa.Double(), nullable=True),
        sa.Column("max_jobs", sa.Integer(), nullable=True),
        sa.Column("max_gpu_minutes", sa.Double(), nullable=True),
        sa.Column("retention", sa.JSON(), nullable=True),
        sa.Column("retention_enforced", sa.Integer(), nullable=False),
        _key("organisations", "tenant_id"),
    )
    op.create_table(
        "users",
        _text("id"),
        _text("name"),
        _text("email", optional=True),
        _text("issuer", optional=True),
        _text("subject", optional=True),
        _time("created_at"),
        _time("last_seen_at", optional=True),
        _time("disabled_at", optional=True),
        _key("users", "id"),
        sa.UniqueConstraint("issuer", "subject", name=op.f("uq_users_issuer_subject")),
        sa.UniqueConstraint("email", name=op.f("uq_users_email")),
    )
    op.create_table(
        "members",
        _text("tenant_id"),
        _text("user_id"),
        _text("role"),
        _text("source"),
        _time("created_at"),
        sa.ForeignKeyConstraint(["user_id"], ["users.id"], ondelete="CASCADE"),
        _key("members", "tenant_id", "user_id"),
    )
    _index("members", "user_id")
    op.create_table(
        "sign_ins",
        _text("state_sha256"),
        _text("nonce"),
        _text("verifier"),
        _text("return_to"),
        _time("created_at"),
        _key("sign_ins", "state_sha256"),
    )
    _index("sign_ins", "created_at")
    op.create_table(
        "usage_sums",
        _text("tenant_id"),
        _text("name"),
        sa.Column("amount", sa.Double(), nullable=False),
        _key("usage_sums", "tenant_id", "name"),
    )
    op.create_table(
        "audit_entries",
        _text("tenant_id"),
        _text("id"),
        sa.Column("number", _BIG, nullable=False),
        _time("at"),
        *(_text(name) for name in ("actor_kind", "actor_id", "action", "target", "address")),
        *(_text(name) for name in ("request_id", "outcome", "details", "hash")),
        _key("audit_entries", "tenant_id", "id"),
    )
    _index("audit_entries", "tenant_id", "target")
    op.create_table(
        "audit_heads",
        _text("tenant_id"),
        sa.Column("number", _BIG, nullable=False),
        _text("hash"),
        sa.Column("removed_number", _BIG, nullable=False),
        _text("removed_hash"),
        _key("audit_heads", "tenant_id"),
    )
    op.create_table(
        "audit_permits",
        _text("tenant_id"),
        sa.Column("up_to", _BIG, nullable=False),
        _key("audit_permits", "tenant_id"),
    )
    op.create_table(
        "provenance_statements",
        _text("bundle_id"),
        _text("tenant_id"),
        _text("envelope"),
        _time("created_at"),
        _key("provenance_statements", "bundle_id"),
    )


def upgrade() -> None:
    postgresql = op.get_bind().dialect.name == "postgresql"
    _create_tables()
    lock(("api_keys", "jobs", "sessions"), "ACCESS EXCLUSIVE")
    op.add_column("api_keys", _text("scopes", optional=True))
    op.add_column("api_keys", _text("user_id", optional=True))
    op.add_column("sessions", _text("user_id", optional=True))
    op.add_column("jobs", _time("gpu_s_reserved", optional=True))
    lock(("blobs",), "SHARE ROW EXCLUSIVE")
    for statement in _POSTGRESQL if postgresql else _SQLITE:
        op.execute(statement)
    op.execute(
        "INSERT INTO usage_sums (tenant_id, name, amount) "
        "SELECT tenant_id, 'bytes', sum(size_bytes) FROM blobs GROUP BY tenant_id HAVING sum(size_bytes) > 0"
    )
    now = "extract(epoch from now())" if postgresql else "unixepoch()"
    op.execute(_ORGANISATIONS.format(now=now))


def downgrade() -> None:
    postgresql = op.get_bind().dialect.name == "postgresql"
    for name in ("added", "removed"):
        op.execute(f"DROP TRIGGER blobs_bytes_{name}" + (" ON blobs" if postgresql else ""))
    for table in _TABLES:
        op.drop_table(table)
    if postgresql:
        for name in ("blobs_bytes_added", "blobs_bytes_removed", "audit_entries_unchanged"):
            op.execute(f"DROP FUNCTION {name}")
        op.execute("DROP FUNCTION audit_entries_kept")
    for table, column in (
        ("api_keys", "scopes"),
        ("api_keys", "user_id"),
        ("sessions", "user_id"),
        ("jobs", "gpu_s_reserved"),
    ):
        op.drop_column(table, column)
