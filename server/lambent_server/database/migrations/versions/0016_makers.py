"""Who made a key, a share link, a subscription or a webhook of a job, and in which session a link."""

import sqlalchemy as sa
from alembic import op
from lambent_server.database.migration_locks import lock

revision = "0016"
down_revision = "0015"

_COLUMNS = (
    *(
        (table, name)
        for table in ("api_keys", "jobs", "shares", "webhooks")
        for name in ("maker_user_id", "maker_key_id")
    ),
    ("login_codes", "maker_session"),
    ("sessions", "maker_session"),
)


def upgrade() -> None:
    lock(tuple(sorted({table for table, _ in _COLUMNS})), "ACCESS EXCLUSIVE")
    for table, name in _COLUMNS:
        op.add_column(table, sa.Column(name, sa.Text(), nullable=True))
    # A person's key made before makers were stored is that person's.
    op.execute("UPDATE api_keys SET maker_user_id = user_id WHERE user_id IS NOT NULL")


def downgrade() -> None:
    for table, name in _COLUMNS:
        op.drop_column(table, name)
