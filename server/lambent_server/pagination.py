"""Pagination of lists: in the order of their creation, with a cursor for the next page."""

import base64
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field
from sqlalchemy import Connection, Select, Table

from lambent_server.database.tenancy import Tenant, rows
from lambent_server.problems import invalid

Cursor = Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]{1,100}$")]
Row = dict[str, Any]


class PageFilter(BaseModel):
    """The page of a list to return."""

    model_config = ConfigDict(extra="forbid")

    limit: Annotated[int, Field(ge=1, le=200)] = 50
    cursor: Cursor | None = None


def _cursor(identifier: str) -> str:
    return base64.urlsafe_b64encode(identifier.encode()).decode().rstrip("=")


def _from_cursor(cursor: str) -> str:
    try:
        return base64.urlsafe_b64decode(cursor + "=" * (-len(cursor) % 4)).decode("ascii")
    except ValueError as error:
        message = "pass the cursor from `next_cursor` unchanged"
        raise invalid("cursor_invalid", "#/query/cursor", message) from error


def select_newest(
    connection: Connection,
    tenant: Tenant,
    table: Table,
    *,
    limit: int,
    cursor: str | None,
    narrow: Any = None,
    oldest_first: bool = False,
) -> tuple[list[Row], str | None]:
    """Return up to `limit` rows, newest or oldest first, and the cursor of the next page.

    Identifiers sort by creation time. `narrow` adds conditions to the selection.
    """
    order = table.c.id.asc() if oldest_first else table.c.id.desc()
    statement: Select[Any] = rows(tenant, table).order_by(order).limit(limit + 1)
    if cursor is not None:
        last = _from_cursor(cursor)
        statement = statement.where(table.c.id > last if oldest_first else table.c.id < last)
    if narrow is not None:
        statement = narrow(statement)
    found = [dict(row) for row in connection.execute(statement).mappings()]
    more = len(found) > limit
    return found[:limit], _cursor(found[limit - 1]["id"]) if more else None
