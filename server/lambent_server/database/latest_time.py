"""The newest time in a database, which the time of a server must not be behind."""

from sqlalchemy import Connection, func, select

from lambent_server.core import clock
from lambent_server.database.columns import clock_time
from lambent_server.database.engine import Database
from lambent_server.database.schema import (
    api_keys,
    bundles,
    checkpoints,
    environments,
    jobs,
    render_orders,
    scenes,
    shares,
)
from lambent_server.database.service_schema import webhook_deliveries, webhooks

_NAMED = (
    api_keys,
    bundles,
    checkpoints,
    environments,
    jobs,
    render_orders,
    scenes,
    shares,
    webhook_deliveries,
    webhooks,
)
"""Tables whose ids begin with the time at which a row was made."""


def latest_time(connection: Connection) -> float:
    """Return the newest time of jobs and of ids (Unix seconds), 0 without rows; the ends of indexes."""
    ids = [connection.execute(select(func.max(table.c.id))).scalar() for table in _NAMED]
    changed = connection.execute(select(func.max(jobs.c.updated_at))).scalar()
    return max([float(changed or 0.0), *(clock.time_of_id(identifier or "") for identifier in ids)])


def begin_time(database: Database) -> None:
    """Let the time of this process be that of the database, and at least that of its newest row."""
    with database.read() as connection:
        seen = latest_time(connection)
        # The last, because the clock runs on meanwhile.
        shown = (
            None if database.is_sqlite else connection.execute(select(clock_time(connection))).scalar_one()
        )
    clock.begin(shown, seen)
