"""Locks of migrations that run while servers of the previous release write."""

import time

import sqlalchemy as sa
from alembic import op

_ATTEMPTS = 120
_PAUSE_S = 0.25
# Shorter than what PostgreSQL waits before it looks for transactions that wait for each other.
_LOCK_TIMEOUT = "500ms"


def serve_from(revision: str) -> None:
    """Say which servers can still use the tables: those whose newest revision is this one or a later one.

    A migration that removes or renames something, or that demands more of rows, has to call this.
    """
    update = sa.text("UPDATE schema_info SET value = :revision WHERE name = 'compatible_from'")
    op.execute(update.bindparams(revision=revision))


def lock(tables: tuple[str, ...], mode: str) -> None:
    """Lock tables (PostgreSQL) without ever holding some of them while waiting for others.

    Transactions of running servers lock them in other orders: one of two that wait for each other would fail.
    """
    connection = op.get_bind()
    if connection.dialect.name != "postgresql":
        return
    for attempt in range(_ATTEMPTS):
        try:
            with connection.begin_nested():
                connection.execute(sa.text(f"SET LOCAL lock_timeout = '{_LOCK_TIMEOUT}'"))
                connection.execute(sa.text(f"LOCK TABLE {', '.join(tables)} IN {mode} MODE"))
                connection.execute(sa.text("SET LOCAL lock_timeout = 0"))
        except sa.exc.OperationalError:
            if attempt + 1 == _ATTEMPTS:
                raise
            time.sleep(_PAUSE_S)
        else:
            return
