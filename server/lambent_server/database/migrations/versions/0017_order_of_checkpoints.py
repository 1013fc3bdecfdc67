"""Checkpoints in the order in which they were committed, instead of that of the clocks of servers."""

import sqlalchemy as sa
from alembic import op
from lambent_server.database.migration_locks import lock

revision = "0017"
down_revision = "0015"

_SEQUENCE = "checkpoints_number"
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


def downgrade() -> None:
    op.drop_index(op.f(_INDEX), table_name="checkpoints")
    op.drop_column("checkpoints", "number")
