"""Organisations: each is a tenant, whose rows no other can read."""

from typing import Any

from sqlalchemy import Connection

from lambent_server.api.problems import Problem, conflict, invalid
from lambent_server.core.clock import now
from lambent_server.database.model import OrganisationRow
from lambent_server.database.people_schema import organisations
from lambent_server.database.rows import many, one
from lambent_server.database.tenancy import Tenant, across_tenants, add_if_absent, change, rows

ID_PATTERN = r"[a-z0-9][a-z0-9_-]{0,39}"


def create(connection: Connection, tenant: Tenant, name: str) -> OrganisationRow:
    """Add an organisation with the limits of the settings; raises `organisation_exists` for a known id."""
    if not name.strip() or len(name) > 100:
        raise invalid("organisation_name_invalid", "#/name", "a name has 1 to 100 characters")
    values = {"name": name.strip(), "created_at": now(), "retention_enforced": 0}
    if not add_if_absent(connection, tenant, organisations, **values):
        raise conflict("organisation_exists", f"there is an organisation {tenant.id!r} already")
    return require(connection, tenant)


def find(connection: Connection, tenant: Tenant) -> OrganisationRow | None:
    """Return the row of an organisation, or None if there is none with this id."""
    return one(connection, rows(tenant, organisations), OrganisationRow)


def require(connection: Connection, tenant: Tenant) -> OrganisationRow:
    """Return the row of an organisation; raises `organisation_not_found` if there is none."""
    row = find(connection, tenant)
    if row is None:
        detail = f"there is no organisation {tenant.id!r}; `lambent admin org create {tenant.id}` makes it"
        raise Problem(404, "organisation_not_found", detail)
    return row


def is_open(connection: Connection, tenant: Tenant) -> bool:
    """Return whether there is an organisation with this id, and nobody has closed it."""
    row = find(connection, tenant)
    return row is not None and row.closed_at is None


def update(connection: Connection, tenant: Tenant, **values: Any) -> OrganisationRow:
    """Change columns of an organisation, and return its row."""
    require(connection, tenant)
    connection.execute(change(tenant, organisations).values(**values))
    return require(connection, tenant)


def all_of_them(connection: Connection) -> list[OrganisationRow]:
    """Return the rows of all organisations, by id."""
    return many(
        connection, across_tenants(organisations).order_by(organisations.c.tenant_id), OrganisationRow
    )
