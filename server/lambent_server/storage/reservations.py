"""Room of a quota that is kept for files which may be sent to a bucket now.

Whoever has the address of an upload can send its bytes without this server. So a file counts from the moment
an address is given away until it is stored, or the time to send it has ended; then what was sent of it is
deleted, and only then does it no longer count.
"""

from collections.abc import Collection, Mapping, Sequence
from typing import Any

from sqlalchemy import Connection, Row, case, delete

from lambent_server.core.clock import now
from lambent_server.core.settings import Settings
from lambent_server.database.columns import insert_or
from lambent_server.database.service_schema import upload_reservations
from lambent_server.database.tenancy import Tenant, across_tenants, change, rows

AT_ONCE = 50
"""Reservations that end in one sweep."""


def amount(connection: Connection, tenant: Tenant, but: Collection[str] = ()) -> float:
    """Return how many bytes are reserved, without the files of the hashes `but`."""
    columns = (upload_reservations.c.sha256, upload_reservations.c.size_bytes)
    sizes = connection.execute(rows(tenant, upload_reservations, *columns))
    return float(sum(size for sha256, size in sizes if sha256 not in but))


def keep(connection: Connection, tenant: Tenant, sizes: Mapping[str, int], settings: Settings) -> None:
    """Reserve room for files by hash and size in bytes, or keep it for longer."""
    if not sizes:
        return
    expires_at = now() + max(settings.store_reserved_s, settings.store_url_s)
    statement = insert_or(connection, upload_reservations)
    new, old = statement.excluded, upload_reservations.c
    # Of two sizes the larger: the earlier address may be the one that is used.
    size = case((new.size_bytes > old.size_bytes, new.size_bytes), else_=old.size_bytes)
    given = {"size_bytes": size, "expires_at": new.expires_at}
    key = (upload_reservations.c.tenant_id, upload_reservations.c.sha256)
    values = [
        {"tenant_id": tenant.id, "sha256": sha256, "size_bytes": float(size), "expires_at": expires_at}
        # In one order, so that two transactions never wait for each other.
        for sha256, size in sorted(sizes.items())
    ]
    connection.execute(statement.on_conflict_do_update(index_elements=key, set_=given), values)


def use(connection: Connection, tenant: Tenant, sha256: str, settings: Settings) -> None:
    """Give back the room of a file that is stored, and counts as such.

    The row stays until no address is valid any more, so that bytes which are sent again are deleted too.
    """
    table, last = upload_reservations.c, now() + settings.store_url_s
    earlier = case((table.expires_at > last, last), else_=table.expires_at)
    used = change(tenant, upload_reservations).where(table.sha256 == sha256)
    connection.execute(used.values(size_bytes=0.0, expires_at=earlier))


def ended(connection: Connection) -> Sequence[Row[Any]]:
    """Return reservations that nobody can use any more."""
    due = upload_reservations.c.expires_at < now()
    statement = across_tenants(upload_reservations).where(due).order_by(upload_reservations.c.expires_at)
    return connection.execute(statement.limit(AT_ONCE)).all()


def forget(connection: Connection, row: Row[Any]) -> None:
    """Delete a reservation that has ended, unless it was made again meanwhile."""
    table = upload_reservations.c
    mine = table.tenant_id == row.tenant_id, table.sha256 == row.sha256
    connection.execute(delete(upload_reservations).where(*mine, table.expires_at == row.expires_at))
