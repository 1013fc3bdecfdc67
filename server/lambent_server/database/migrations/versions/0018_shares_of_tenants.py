"""Whose turn it is to get a run, uploads to a bucket that were promised room, and deliveries by tenant."""

import sqlalchemy as sa
from alembic import op
from lambent_server.database.migration_locks import lock

revision = "0018"
down_revision = "0017"


def upgrade() -> None:
    op.create_table(
        "tenant_turns",
        sa.Column("tenant_id", sa.Text(), nullable=False),
        sa.Column("turn", sa.Integer(), nullable=False),
        sa.PrimaryKeyConstraint("tenant_id", name=op.f("pk_tenant_turns")),
    )
    op.create_table(
        "upload_reservations",
        sa.Column("tenant_id", sa.Text(), nullable=False),
        sa.Column("sha256", sa.Text(), nullable=False),
        sa.Column("size_bytes", sa.Double(), nullable=False),
        sa.Column("expires_at", sa.Double(), nullable=False),
        sa.PrimaryKeyConstraint("tenant_id", "sha256", name=op.f("pk_upload_reservations")),
    )
    op.create_index(
        op.f("ix_upload_reservations_expires_at"), "upload_reservations", ["expires_at"], unique=False
    )
    lock(("webhook_deliveries",), "SHARE")
    op.create_index(
        op.f("ix_webhook_deliveries_tenant_id_next_at"),
        "webhook_deliveries",
        ["tenant_id", "next_at"],
        unique=False,
    )


def downgrade() -> None:
    op.drop_index(op.f("ix_webhook_deliveries_tenant_id_next_at"), table_name="webhook_deliveries")
    op.drop_table("upload_reservations")
    op.drop_table("tenant_turns")
