"""Who made a one-time link for a browser: the link, and the session that it opened, end with them."""

import sqlalchemy as sa
from alembic import op
from lambent_server.database.migration_locks import lock

revision = "0015"
down_revision = "0014"

_TABLES = ("login_codes", "sessions")
_COLUMNS = ("maker_user_id", "maker_key_id")


def upgrade() -> None:
    lock(_TABLES, "ACCESS EXCLUSIVE")
    for table in _TABLES:
        for name in _COLUMNS:
            op.add_column(table, sa.Column(name, sa.Text(), nullable=True))


def downgrade() -> None:
    for table in _TABLES:
        for name in _COLUMNS:
            op.drop_column(table, name)
