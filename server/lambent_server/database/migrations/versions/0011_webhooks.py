"""Webhooks with their outbox, labels of scenes and bundles, and what operators tell all servers."""

import sqlalchemy as sa
from alembic import op
from lambent_server.database.migration_locks import lock

revision = "0011"
down_revision = "0010"


def _text(name: str, *, optional: bool = False) -> sa.Column[str]:
    return sa.Column(name, sa.Text(), nullable=optional)


def _time(name: str, *, optional: bool = False) -> sa.Column[float]:
    return sa.Column(name, sa.Double(), nullable=optional)


def _index(table: str, *columns: str) -> None:
    op.create_index(op.f(f"ix_{table}_{'_'.join(columns)}"), table, list(columns), unique=False)


def upgrade() -> None:
    lock(("bundles", "jobs", "scenes"), "ACCESS EXCLUSIVE")
    op.add_column("jobs", _text("webhook", optional=True))
    op.create_table(
        "webhooks",
        _text("id"),
        _text("tenant_id"),
        _text("name"),
        _text("url"),
        sa.Column("events", sa.JSON(), nullable=False),
        sa.Column("labels", sa.JSON(), nullable=False),
        _text("secret"),
        _text("previous_secret", optional=True),
        _time("previous_until", optional=True),
        _time("created_at"),
        _time("disabled_at", optional=True),
        _text("disabled_reason"),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_webhooks")),
    )
    _index("webhooks", "tenant_id", "id")
    op.create_table(
        "webhook_secrets",
        _text("tenant_id"),
        _text("secret"),
        _text("previous_secret", optional=True),
        _time("previous_until", optional=True),
        sa.PrimaryKeyConstraint("tenant_id", name=op.f("pk_webhook_secrets")),
    )
    op.create_table(
        "webhook_deliveries",
        _text("id"),
        _text("tenant_id"),
        _text("webhook_id", optional=True),
        _text("job_id", optional=True),
        _text("event"),
        _text("url"),
        _text("host"),
        _text("body"),
        _text("state"),
        _time("created_at"),
        _time("since"),
        _time("next_at", optional=True),
        _text("claim", optional=True),
        sa.Column("num_attempts", sa.Integer(), nullable=False),
        sa.Column("attempts", sa.JSON(), nullable=False),
        _time("ended_at", optional=True),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_webhook_deliveries")),
    )
    _index("webhook_deliveries", "next_at")
    _index("webhook_deliveries", "tenant_id", "id")
    _index("webhook_deliveries", "webhook_id")
    _index("webhook_deliveries", "job_id")
    _index("webhook_deliveries", "ended_at")
    op.create_table(
        "resource_labels",
        _text("owner_id"),
        _text("name"),
        _text("tenant_id"),
        _text("value"),
        sa.PrimaryKeyConstraint("owner_id", "name", name=op.f("pk_resource_labels")),
    )
    _index("resource_labels", "tenant_id", "name", "value")
    for table in ("scenes", "bundles"):
        op.add_column(table, sa.Column("labels", sa.JSON(), nullable=True))
    op.create_table(
        "server_state",
        _text("name"),
        _time("since"),
        _text("message"),
        sa.Column("retry_after_s", sa.Integer(), nullable=False),
        sa.PrimaryKeyConstraint("name", name=op.f("pk_server_state")),
    )


def downgrade() -> None:
    for table in ("server_state", "resource_labels", "webhook_deliveries", "webhook_secrets", "webhooks"):
        op.drop_table(table)
    for table in ("bundles", "scenes"):
        op.drop_column(table, "labels")
    op.drop_column("jobs", "webhook")
