"""The only statements that routes may build: each is limited to the rows of one tenant."""

from dataclasses import dataclass
from typing import Any

from sqlalchemy import (
    Connection,
    Delete,
    Insert,
    Select,
    Table,
    Update,
    delete,
    insert,
    literal_column,
    select,
    update,
)

from lambent_server.database.columns import insert_or
from lambent_server.database.rows import Kind, one, table_of

DEFAULT_TENANT_ID = "default"


@dataclass(frozen=True, slots=True)
class Tenant:
    """The tenant whose rows a statement reads or changes."""

    id: str


def rows(tenant: Tenant, table: Table, *columns: Any) -> Select[Any]:
    """Return a SELECT of rows of `tenant`."""
    return select(*(columns or (table,))).where(table.c.tenant_id == tenant.id)


def rows_by_other_index(tenant: Tenant, table: Table, *columns: Any) -> Select[Any]:
    """Return a SELECT of rows of `tenant` that the index of another condition is to find.

    Databases take all tenants to have equally many rows, and would read all those of a large one.
    """
    return select(*(columns or (table,))).where(without_index(table.c.tenant_id) == tenant.id)


def without_index(column: Any) -> Any:
    """Return a text column so that no index of it is used."""
    return column.concat(literal_column("''"))


def change(tenant: Tenant, table: Table) -> Update:
    """Return an UPDATE of rows of `tenant`."""
    return update(table).where(table.c.tenant_id == tenant.id)


def remove(tenant: Tenant, table: Table) -> Delete:
    """Return a DELETE of rows of `tenant`."""
    return delete(table).where(table.c.tenant_id == tenant.id)


def add(tenant: Tenant, table: Table, **values: Any) -> Insert:
    """Return an INSERT of a row of `tenant`."""
    return insert(table).values(tenant_id=tenant.id, **values)


def add_if_absent(connection: Connection, tenant: Tenant, table: Table, **values: Any) -> bool:
    """Insert a row of `tenant` unless its key exists; return whether it was inserted.

    If another transaction is about to insert the same key, this waits for its end.
    """
    statement = insert_or(connection, table).values(tenant_id=tenant.id, **values).on_conflict_do_nothing()
    return connection.execute(statement.returning(table.c.tenant_id)).first() is not None


def find(
    connection: Connection, tenant: Tenant, kind: type[Kind], identifier: str, *, lock: bool = False
) -> Kind | None:
    """Return the row of `tenant` with this id, or None, also for rows of other tenants.

    With `lock`, no other transaction can change it before this one ends.
    """
    table = table_of(kind)
    statement = rows(tenant, table).where(table.c.id == identifier)
    return one(connection, statement.with_for_update() if lock else statement, kind)


def across_tenants(table: Table, *columns: Any) -> Select[Any]:
    """Return a SELECT of rows of all tenants: for the controller and the sweeper, never for a route."""
    return select(*(columns or (table,)))
