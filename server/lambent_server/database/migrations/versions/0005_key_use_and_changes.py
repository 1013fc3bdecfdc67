"""The time of a key's last use, and an index of recently changed jobs."""

import sqlalchemy as sa
from alembic import op

revision = "0005"
down_revision = "0004"


def upgrade() -> None:
    op.add_column("api_keys", sa.Column("last_used_at", sa.Double(), nullable=True))
    op.create_index(op.f("ix_jobs_updated_at"), "jobs", ["updated_at"], unique=False)


def downgrade() -> None:
    op.drop_index(op.f("ix_jobs_updated_at"), table_name="jobs")
    op.drop_column("api_keys", "last_used_at")
