"""Labels of scenes, bundles and jobs: changes as RFC 7396 describes them, and conditions of lists."""

from collections.abc import Mapping, Sequence

from sqlalchemy import Column, ColumnElement, Connection, Table, insert

from lambent_server.api.problems import invalid
from lambent_server.database.schema import job_labels
from lambent_server.database.service_schema import resource_labels
from lambent_server.database.tenancy import Tenant, remove, rows

MAX_LABELS = 32


def merged(before: Mapping[str, str] | None, change: Mapping[str, str | None]) -> dict[str, str]:
    """Return labels after a change: null removes one, and what is not named stays."""
    after = {**(before or {}), **change}
    kept = {name: value for name, value in after.items() if value is not None}
    if len(kept) > MAX_LABELS:
        message = f"{len(kept)} labels would be set, {MAX_LABELS} are allowed"
        raise invalid("too_many_labels", "#/labels", message)
    return kept


def _owner(table: Table) -> Column[str]:
    return table.c.job_id if table is job_labels else table.c.owner_id


def store(
    connection: Connection,
    tenant: Tenant,
    owner_id: str,
    labels: Mapping[str, str],
    table: Table = resource_labels,
) -> None:
    """Replace the rows by which something is found by its labels."""
    forget(connection, tenant, owner_id, table)
    column = _owner(table).name
    values = [
        {column: owner_id, "tenant_id": tenant.id, "name": name, "value": value}
        for name, value in labels.items()
    ]
    if values:
        connection.execute(insert(table), values)


def forget(connection: Connection, tenant: Tenant, owner_id: str, table: Table = resource_labels) -> None:
    """Delete these rows."""
    connection.execute(remove(tenant, table).where(_owner(table) == owner_id))


def lacking(
    tenant: Tenant, identifier: Column[str], name: str, table: Table = resource_labels
) -> ColumnElement[bool]:
    """Return the condition that something has no label of this name, whatever its value."""
    return identifier.not_in(rows(tenant, table, _owner(table)).where(table.c.name == name))


def having(
    tenant: Tenant, identifier: Column[str], pairs: Sequence[str], table: Table = resource_labels
) -> list[ColumnElement[bool]]:
    """Return the conditions that something has every label of `pairs` ("name=value")."""
    given = [pair.partition("=")[::2] for pair in pairs]
    labelled = rows(tenant, table, _owner(table))
    return [
        identifier.in_(labelled.where(table.c.name == name, table.c.value == value)) for name, value in given
    ]
