"""Rows as dataclasses: tables are made from these, and they from what a statement returns, both only here."""

from collections.abc import Callable
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, TypeVar, get_args, get_origin, get_type_hints

from sqlalchemy import (
    JSON,
    Column,
    Connection,
    Double,
    Integer,
    PrimaryKeyConstraint,
    Select,
    Table,
    Text,
)
from sqlalchemy.schema import SchemaItem
from sqlalchemy.types import TypeEngine

from lambent_server.database.columns import metadata

Kind = TypeVar("Kind")
_TYPES: dict[Any, type[TypeEngine[Any]]] = {str: Text, int: Integer, float: Double}
_TABLES: dict[type, Table] = {}


def table(name: str, kind: type, *parts: SchemaItem) -> Table:
    """Return the table whose rows are of a class: a field that may be None may be null, counts begin at 0.

    The field `id` is the key unless `parts` say otherwise.
    """
    has_key = any(isinstance(each, PrimaryKeyConstraint) for each in parts)
    hints = get_type_hints(kind, include_extras=True)
    columns = [_column(name, hint, is_key=name == "id" and not has_key) for name, hint in hints.items()]
    return _TABLES.setdefault(kind, Table(name, metadata, *columns, *parts))


def _column(name: str, hint: Any, *, is_key: bool) -> Column[Any]:
    given = get_args(hint) if isinstance(hint, UnionType) else (hint,)
    nullable, plain = NoneType in given, get_origin(given[0])
    if plain is Annotated:
        return Column(name, get_args(given[0])[1], nullable=nullable)
    if plain in (dict, list):
        return Column(name, JSON(none_as_null=nullable), nullable=nullable)
    default = 0 if hint is int else None
    return Column(
        name,
        Text if plain is Literal else _TYPES[given[0]],
        nullable=nullable,
        primary_key=is_key,
        default=default,
    )


def table_of(kind: type) -> Table:
    """Return the table of a class of rows."""
    return _TABLES[kind]


def one(connection: Connection, statement: Select[Any], kind: Callable[..., Kind]) -> Kind | None:
    """Return the only row of a query, or None if it finds none."""
    row = connection.execute(statement).mappings().one_or_none()
    return None if row is None else kind(**row)


def many(connection: Connection, statement: Select[Any], kind: Callable[..., Kind]) -> list[Kind]:
    """Return all rows of a query."""
    return [kind(**row) for row in connection.execute(statement).mappings()]
