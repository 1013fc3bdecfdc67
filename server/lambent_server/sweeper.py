"""Removes blobs that nothing refers to any more, and what was kept only for a time."""

from sqlalchemy import Connection, Table, delete, exists, select

from lambent_server.clock import now
from lambent_server.database.schema import (
    artifacts,
    blobs,
    bundle_files,
    checkpoint_files,
    environments,
    events,
    garbage,
    idempotency_keys,
    scene_files,
    sessions,
)
from lambent_server.database.tenancy import Tenant, across_tenants, add, remove, rows
from lambent_server.services import Services

_REFERENCES: tuple[Table, ...] = (
    scene_files,
    checkpoint_files,
    artifacts,
    bundle_files,
    environments,
    events,
)


def discard(connection: Connection, tenant: Tenant, sha256: str) -> None:
    """Note that a reference to a blob has gone; the blob is swept away later if it was the last one."""
    mine = rows(tenant, garbage, garbage.c.sha256).where(garbage.c.sha256 == sha256)
    if connection.execute(mine).first() is None:
        connection.execute(add(tenant, garbage, sha256=sha256, at=now()))


def _referenced(connection: Connection, tenant: Tenant, sha256: str) -> bool:
    return any(
        connection.execute(
            select(
                exists(rows(tenant, table).where(table.c.sha256 == sha256).with_only_columns(table.c.sha256))
            )
        ).scalar_one()
        for table in _REFERENCES
    )


def sweep(services: Services) -> int:
    """Remove what is due and return how many blobs went."""
    settings, swept = services.settings, 0
    with services.database.write() as connection:
        connection.execute(delete(sessions).where(sessions.c.expires_at < now()))
        old = now() - settings.idempotency_s
        connection.execute(delete(idempotency_keys).where(idempotency_keys.c.created_at < old))
        before = now() - settings.garbage_after_s
        due = connection.execute(across_tenants(garbage).where(garbage.c.at < before)).mappings().all()
    for row in due:
        tenant, sha256 = Tenant(row["tenant_id"]), row["sha256"]
        with services.store.lock:
            with services.database.write() as connection:
                connection.execute(remove(tenant, garbage).where(garbage.c.sha256 == sha256))
                if _referenced(connection, tenant, sha256):
                    continue
                statement = remove(tenant, blobs).where(blobs.c.sha256 == sha256, blobs.c.touched_at < before)
                if connection.execute(statement).rowcount == 0:
                    continue
                others = across_tenants(blobs, blobs.c.sha256).where(blobs.c.sha256 == sha256)
                last = connection.execute(others).first() is None
            if last:
                services.store.delete(sha256)
                swept += 1
    return swept
