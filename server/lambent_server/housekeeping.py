"""Removal of blobs without references, abandoned uploads, and old sessions and keys."""

from typing import Any

from sqlalchemy import Column, Connection, delete, exists, select

from lambent_server import scene_rows
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
    scene_figures,
    scene_files,
    scenes,
    sessions,
    shares,
)
from lambent_server.database.tenancy import Tenant, across_tenants, remove, rows
from lambent_server.services import Services

ENDED_SHARE_S = 30 * 86400.0
"""How long after its expiry a link is known to have ended."""
_REFERENCES: tuple[Column[Any], ...] = (
    scene_files.c.sha256,
    scene_figures.c.sha256,
    scenes.c.thumbnail_sha256,
    checkpoint_files.c.sha256,
    artifacts.c.sha256,
    bundle_files.c.sha256,
    environments.c.sha256,
    events.c.sha256,
)


def sweep(services: Services) -> int:
    """Remove what is due and return the number of blobs removed."""
    _expire(services)
    before = now() - services.settings.garbage_after_s
    with services.database.read() as connection:
        due = connection.execute(across_tenants(garbage).where(garbage.c.at < before)).mappings().all()
    return sum(_remove_blob(services, Tenant(row["tenant_id"]), row["sha256"], before) for row in due)


def _expire(services: Services) -> None:
    settings = services.settings
    with services.database.write() as connection:
        connection.execute(delete(sessions).where(sessions.c.expires_at < now()))
        # Until then the page of a link says that it has ended, in the frames where it was shown.
        ended = now() - ENDED_SHARE_S
        connection.execute(delete(shares).where(shares.c.expires_at < ended))
        old = now() - settings.idempotency_s
        connection.execute(delete(idempotency_keys).where(idempotency_keys.c.created_at < old))
        abandoned = across_tenants(scenes).where(
            scenes.c.state == "open", scenes.c.created_at < now() - settings.open_scene_s
        )
        for scene in connection.execute(abandoned).mappings().all():
            scene_rows.delete(connection, Tenant(scene["tenant_id"]), dict(scene))


def _referenced(connection: Connection, tenant: Tenant, sha256: str) -> bool:
    return any(
        connection.execute(
            select(exists(rows(tenant, column.table, column).where(column == sha256)))
        ).scalar_one()
        for column in _REFERENCES
    )


def _remove_blob(services: Services, tenant: Tenant, sha256: str, before: float) -> bool:
    """Remove an unreferenced blob, unless it was just sent again; return whether its bytes were removed."""
    mine = garbage.c.sha256 == sha256
    with services.store.lock:
        with services.database.write() as connection:
            if not _referenced(connection, tenant, sha256):
                young = rows(tenant, blobs).where(blobs.c.sha256 == sha256, blobs.c.touched_at >= before)
                if connection.execute(young).first() is not None:
                    return False
                connection.execute(remove(tenant, blobs).where(blobs.c.sha256 == sha256))
            connection.execute(remove(tenant, garbage).where(mine))
            anybody = across_tenants(blobs, blobs.c.sha256).where(blobs.c.sha256 == sha256)
            if connection.execute(anybody).first() is not None:
                return False
        services.store.delete(sha256)
    return True
