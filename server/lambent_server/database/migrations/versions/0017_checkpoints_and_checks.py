"""The order in which checkpoints were committed, whatever clocks say, and when bytes were checked."""

import sqlalchemy as sa
from alembic import op
from lambent_server.database.migration_locks import lock

revision = "0017"
down_revision = "0016"

_SEQUENCE = "checkpoints_number"
_CHECKED = "ix_blob_claims_checked_at"
_INDEX = "ix_checkpoints_number"


def upgrade() -> None:
    postgresql = op.get_bind().dialect.name == "postgresql"
    lock(("checkpoints",), "ACCESS EXCLUSIVE")
    op.add_column("checkpoints", sa.Column("number", sa.BigInteger(), server_default="0", nullable=False))
    op.execute(
        "UPDATE checkpoints SET number = ordered.place FROM "
        "(SELECT id, row_number() OVER (ORDER BY id) AS place FROM checkpoints) AS ordered "
        "WHERE checkpoints.id = ordered.id"
    )
    if postgresql:
        op.execute(f"CREATE SEQUENCE {_SEQUENCE} OWNED BY checkpoints.number")
        op.execute(
            f"SELECT setval('{_SEQUENCE}', (SELECT coalesce(max(number), 0) + 1 FROM checkpoints), false)"
        )
        # For servers of the release before.
        op.execute(f"ALTER TABLE checkpoints ALTER COLUMN number SET DEFAULT nextval('{_SEQUENCE}')")
    op.create_index(op.f(_INDEX), "checkpoints", ["number"], unique=False)
    lock(("blob_claims",), "ACCESS EXCLUSIVE")
    op.add_column("blob_claims", sa.Column("checked_at", sa.Double(), server_default="0", nullable=False))
    op.create_index(op.f(_CHECKED), "blob_claims", ["checked_at"], unique=False)


def downgrade() -> None:
    op.drop_index(op.f(_CHECKED), table_name="blob_claims")
    op.drop_column("blob_claims", "checked_at")
    op.drop_index(op.f(_INDEX), table_name="checkpoints")
    op.drop_column("checkpoints", "number")
