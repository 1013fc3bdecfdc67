"""Pagination of lists: in the order of their creation, with a cursor for the next page."""

import base64
import json
import re
from collections.abc import Callable, Sequence
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field
from sqlalchemy import Column, ColumnElement, Connection, Select, tuple_

from lambent_server.api.outside_text import parse_json
from lambent_server.api.problems import Problem, invalid
from lambent_server.database.rows import Kind, many, table_of
from lambent_server.database.tenancy import Tenant, rows

Cursor = Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]{1,2000}$")]
Labels = Annotated[
    list[Annotated[str, Field(pattern=r"^[A-Za-z0-9._-]{1,63}=[^\x00-\x1f\x7f]{0,200}$")]],
    Field(max_length=8, description='"name=value"; all must hold', default_factory=list),
]

_ID = re.compile(r"[A-Za-z0-9_.-]{1,64}")
# Of a column of whole numbers, in both databases.
_MAX_COUNT = 2**31 - 1


class PageFilter(BaseModel):
    """The page of a list to return."""

    model_config = ConfigDict(extra="forbid")

    limit: Annotated[int, Field(ge=1, le=200)] = 50
    cursor: Cursor | None = None


class LabelFilter(PageFilter):
    """The page of a list of what has these labels."""

    label: Labels


class LongPageFilter(PageFilter):
    """The page of a list whose entries are small."""

    limit: Annotated[int, Field(ge=1, le=1000)] = 1000


class FilePageFilter(PageFilter):
    """The page of a list of files."""

    limit: Annotated[int, Field(ge=1, le=10_000)] = 10_000


def _cursor(identifier: str) -> str:
    return base64.urlsafe_b64encode(identifier.encode()).decode().rstrip("=")


def _from_cursor(cursor: str) -> str:
    """Return what `_cursor` was given; raises `cursor_invalid` for any text that it would not return."""
    try:
        text = base64.urlsafe_b64decode(cursor + "=" * (-len(cursor) % 4)).decode("utf-8")
    except ValueError as error:
        raise _unusable() from error
    if _cursor(text) != cursor:
        raise _unusable()
    return text


def _id_of(cursor: str) -> str:
    """Return the id in a cursor."""
    text = _from_cursor(cursor)
    if _ID.fullmatch(text) is None:
        raise _unusable()
    return text


def _written(values: list[Any]) -> str:
    """Return the text of a cursor; in UTF-8, which is shorter than the escapes of JSON."""
    return json.dumps(values, ensure_ascii=False, separators=(",", ":"))


def _unusable() -> Problem:
    message = "pass the cursor from `next_cursor` unchanged"
    return invalid("cursor_invalid", "#/query/cursor", message)


def select_ordered(
    connection: Connection,
    kind: type[Kind],
    statement: Select[Any],
    columns: Sequence[Column[Any]],
    page: PageFilter,
) -> tuple[list[Kind], str | None]:
    """Return a page of rows in the order of `columns`, and the cursor of the next one.

    Together the columns are different in every row.
    """
    if page.cursor is not None:
        statement = statement.where(tuple_(*columns) > tuple_(*_values(page.cursor, columns)))
    items = many(connection, statement.order_by(*columns).limit(page.limit + 1), kind)
    if len(items) <= page.limit:
        return items, None
    last = items[page.limit - 1]
    return items[: page.limit], _cursor(_written([getattr(last, column.name) for column in columns]))


def _values(cursor: str, columns: Sequence[Column[Any]]) -> list[Any]:
    """Return what the last row of the page before had in these columns."""
    try:
        values = parse_json(_from_cursor(cursor).encode())
    except Problem as problem:
        raise _unusable() from problem
    kinds = [column.type.python_type for column in columns]
    if not isinstance(values, list) or [type(value) for value in values] != kinds:
        raise _unusable()
    if any(isinstance(value, int) and not 0 <= value <= _MAX_COUNT for value in values):
        raise _unusable()
    return values


def select_newest(
    connection: Connection,
    tenant: Tenant,
    kind: type[Kind],
    *conditions: ColumnElement[bool],
    page: PageFilter,
) -> tuple[list[Kind], str | None]:
    """Return a page of rows, newest first, and the cursor of the next one."""
    table = table_of(kind)

    def select_after(last: str | None, num_rows: int) -> Select[Any]:
        statement = rows(tenant, table).where(*conditions)
        if last is not None:
            statement = statement.where(table.c.id < last)
        return statement.order_by(table.c.id.desc()).limit(num_rows)

    return read_page(connection, select_after, page, kind)


def read_page(
    connection: Connection,
    select_after: Callable[[str | None, int], Select[Any]],
    page: PageFilter,
    kind: Callable[..., Kind],
) -> tuple[list[Kind], str | None]:
    """Return a page of a query, and the cursor of the next one.

    `select_after` makes the query of so many rows after the row with an id.
    """
    statement = select_after(None if page.cursor is None else _id_of(page.cursor), page.limit + 1)
    page_rows = connection.execute(statement).mappings().all()
    cursor = _cursor(page_rows[page.limit - 1]["id"]) if len(page_rows) > page.limit else None
    return [kind(**row) for row in page_rows[: page.limit]], cursor
