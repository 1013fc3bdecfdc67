"""Announcing changes to every server on the database (PostgreSQL's NOTIFY)."""

from sqlalchemy import Connection, func, select

CHANNEL = "lambent_changes"


def announce(connection: Connection, payload: str = "") -> None:
    """Announce a change of jobs when the transaction commits; once, however often this is called."""
    if connection.dialect.name == "postgresql":
        connection.execute(select(func.pg_notify(CHANNEL, payload)))
