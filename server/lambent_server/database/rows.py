"""Rows as dataclasses: the only place that makes them from what a statement returns."""

from collections.abc import Callable
from typing import Any, TypeVar

from sqlalchemy import Connection, Select

Kind = TypeVar("Kind")


def one(connection: Connection, statement: Select[Any], kind: Callable[..., Kind]) -> Kind | None:
    """Return the only row of a query, or None if it finds none."""
    found = connection.execute(statement).mappings().one_or_none()
    return None if found is None else kind(**found)


def many(connection: Connection, statement: Select[Any], kind: Callable[..., Kind]) -> list[Kind]:
    """Return all rows of a query."""
    return [kind(**row) for row in connection.execute(statement).mappings()]
