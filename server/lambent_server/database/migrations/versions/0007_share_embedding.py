"""The origins whose pages may show a shared bundle."""

import sqlalchemy as sa
from alembic import op

revision = "0007"
down_revision = "0006"


def upgrade() -> None:
    op.add_column("shares", sa.Column("frame_ancestors", sa.Text(), nullable=True))


def downgrade() -> None:
    op.drop_column("shares", "frame_ancestors")
