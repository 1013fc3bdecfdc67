"""The only statements that routes may build: each needs to be told whose rows it is about."""

from dataclasses import dataclass
from importlib import import_module
from typing import Any

from sqlalchemy import (
    Connection,
    Delete,
    Insert,
    RowMapping,
    Select,
    Table,
    Update,
    delete,
    insert,
    select,
    update,
)

DEFAULT_TENANT_ID = "default"


@dataclass(frozen=True, slots=True)
class Tenant:
    """Whose rows a statement reads or changes."""

    id: str


def rows(tenant: Tenant, table: Table, *columns: Any) -> Select[Any]:
    """Return a selection from the rows of `tenant`."""
    return select(*(columns or (table,))).where(table.c.tenant_id == tenant.id)


def change(tenant: Tenant, table: Table) -> Update:
    """Return an update of the rows of `tenant`."""
    return update(table).where(table.c.tenant_id == tenant.id)


def remove(tenant: Tenant, table: Table) -> Delete:
    """Return a removal of rows of `tenant`."""
    return delete(table).where(table.c.tenant_id == tenant.id)


def add(tenant: Tenant, table: Table, **values: Any) -> Insert:
    """Return an insertion of a row of `tenant`."""
    return insert(table).values(tenant_id=tenant.id, **values)


def add_if_absent(connection: Connection, tenant: Tenant, table: Table, **values: Any) -> bool:
    """Insert a row of `tenant` unless its key is there already; return whether it was inserted.

    Where another transaction is about to insert the same key, its end is waited for.
    """
    # One of them is imported already by the engine; the other would cost start-up time for nothing.
    kind: Any = import_module(f"sqlalchemy.dialects.{connection.dialect.name}").insert
    statement = kind(table).values(tenant_id=tenant.id, **values).on_conflict_do_nothing()
    return connection.execute(statement.returning(table.c.tenant_id)).first() is not None


def find(
    connection: Connection, tenant: Tenant, table: Table, identifier: str, *, lock: bool = False
) -> RowMapping | None:
    """Return the row of `tenant` with this id, or None; another tenant's row is none.

    With `lock` nobody else changes it before this transaction ends.
    """
    statement = rows(tenant, table).where(table.c.id == identifier)
    if lock:
        statement = statement.with_for_update()
    return connection.execute(statement).mappings().one_or_none()


def across_tenants(table: Table, *columns: Any) -> Select[Any]:
    """Return a selection from everybody's rows: for the controller and the sweeper, never for a route."""
    return select(*(columns or (table,)))
