"""The registry of all tables, and what both databases say differently: upserts, sequences, the clock."""

from importlib import import_module
from typing import Any

from sqlalchemy import (
    Column,
    ColumnElement,
    Connection,
    Double,
    MetaData,
    Table,
    cast,
    extract,
    func,
    literal,
    select,
)

from lambent_server.core.clock import now

metadata = MetaData(
    naming_convention={
        "ix": "ix_%(table_name)s_%(column_0_N_name)s",
        "uq": "uq_%(table_name)s_%(column_0_N_name)s",
        "pk": "pk_%(table_name)s",
    }
)


def insert_or(connection: Connection, table: Table) -> Any:
    """Return an INSERT into `table` that can say what happens where the key exists (`on_conflict_...`)."""
    # The engine has imported one of them already; the other would only cost start-up time.
    return import_module(f"sqlalchemy.dialects.{connection.dialect.name}").insert(table)


def next_number(connection: Connection, column: Column[int]) -> ColumnElement[int]:
    """Return the expression of a number that is larger than every one before it in `column`.

    PostgreSQL counts with a sequence, which `creation` makes; SQLite has one writer.
    """
    if connection.dialect.name == "postgresql":
        return func.nextval(f"{column.table.name}_{column.name}")
    return select(func.coalesce(func.max(column), 0) + 1).scalar_subquery()


def clock_time(connection: Connection) -> ColumnElement[float]:
    """Return the expression of the time now (Unix seconds), by the one clock that all servers share."""
    if connection.dialect.name == "postgresql":
        return cast(extract("epoch", func.clock_timestamp()), Double)
    return literal(now(), Double)
