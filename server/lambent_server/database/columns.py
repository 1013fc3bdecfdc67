"""The kinds of columns that tables have, the registry of all tables, and the clock of the database."""

from sqlalchemy import (
    Column,
    ColumnElement,
    Connection,
    Double,
    Integer,
    MetaData,
    Text,
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


def text_column(name: str) -> Column[str]:
    """Return a column of a text."""
    return Column(name, Text, nullable=False)


def time_column(name: str) -> Column[float]:
    """Return a column of a time."""
    return Column(name, Double, nullable=False)


def count_column(name: str) -> Column[int]:
    """Return a column of a whole number, 0 by default."""
    return Column(name, Integer, nullable=False, default=0)


def id_column() -> Column[str]:
    """Return the column of the key `id`."""
    return Column("id", Text, primary_key=True)


def optional_text_column(name: str) -> Column[str | None]:
    """Return a column of a text or null."""
    return Column(name, Text)


def optional_time_column(name: str) -> Column[float | None]:
    """Return a column of a time or null."""
    return Column(name, Double)


def next_number(connection: Connection, column: Column[int]) -> ColumnElement[int]:
    """Return the expression of a number that is larger than every one before it in `column`.

    PostgreSQL counts with a sequence, which the migration makes; SQLite has one writer.
    """
    if connection.dialect.name == "postgresql":
        return func.nextval(f"{column.table.name}_{column.name}")
    return select(func.coalesce(func.max(column), 0) + 1).scalar_subquery()


def maker_columns() -> tuple[Column[str | None], Column[str | None]]:
    """Return the columns of the user or the key that made a row; neither: the server, or an operator."""
    return optional_text_column("maker_user_id"), optional_text_column("maker_key_id")


def clock_time(connection: Connection) -> ColumnElement[float]:
    """Return the expression of the time now (Unix seconds), by the one clock that all servers share."""
    if connection.dialect.name == "postgresql":
        return cast(extract("epoch", func.clock_timestamp()), Double)
    return literal(now(), Double)
