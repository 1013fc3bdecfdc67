"""Removal of blobs without references, abandoned uploads, and old sessions and keys."""

import time
from typing import Any

import structlog
from sqlalchemy import Column, Connection, Select, delete, exists, literal_column, select

from lambent_server.cluster import claims
from lambent_server.core.clock import now, skipped_s
from lambent_server.core.settings import Settings
from lambent_server.database.cluster_schema import run_logs
from lambent_server.database.model import SceneRow
from lambent_server.database.rows import many
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
from lambent_server.database.service_schema import webhook_deliveries
from lambent_server.database.tenancy import Tenant, across_tenants, change, remove, rows
from lambent_server.jobs import counts as job_counts
from lambent_server.receiving.direct import DirectUploads
from lambent_server.scenes import rows as scene_rows
from lambent_server.services import Services
from lambent_server.storage import reservations
from lambent_server.storage.s3 import StoreUnavailableError

log = structlog.get_logger()

ENDED_SHARE_S = 30 * 86400.0
"""How long after its expiry a link is known to have ended."""
AT_ONCE = 200
"""Blobs of one sweep: the controller, which sweeps, must not leave its jobs alone for long."""
SWEEP_S = 2.0
"""Time of one sweep, where a busy database or store makes each of them slow."""
SCENES_AT_ONCE = 5
REFERENCES: tuple[Column[Any], ...] = (
    scene_files.c.sha256,
    scene_figures.c.sha256,
    scenes.c.thumbnail_sha256,
    checkpoint_files.c.sha256,
    artifacts.c.sha256,
    bundle_files.c.sha256,
    environments.c.sha256,
    events.c.sha256,
    run_logs.c.sha256,
)
"""Every column that refers to a blob."""


def sweep(services: Services) -> int:
    """Remove what is due, and return the number of blobs removed.

    At most `AT_ONCE` blobs and about `SWEEP_S` seconds.
    """
    job_counts.fold(services.database)
    _expire(services)
    _end_reservations(services)
    before = garbage_before(services.settings)
    with services.database.read() as connection:
        due = connection.execute(_due(before).limit(AT_ONCE)).all()
        begun = claims.announced(connection)
    removed = sum(services.store.delete(services.database.write, *deletion) for deletion in begun)
    until = time.monotonic() + SWEEP_S
    for row in due:
        removed += _remove_blob(services, Tenant(row.tenant_id), row.sha256, before)
        if time.monotonic() > until:
            break
    return removed


def _end_reservations(services: Services) -> None:
    """Delete what was sent to the bucket and never taken over, and count it no more."""
    with services.database.read() as connection:
        rows_ended = reservations.ended(connection)
    bucket = services.store.bucket
    direct = None if bucket is None else DirectUploads(services.store, bucket, services.settings)
    until = time.monotonic() + SWEEP_S
    for row in rows_ended:
        try:
            if direct is not None:
                direct.discard(Tenant(row.tenant_id), row.sha256)
        except StoreUnavailableError as error:
            # It counts until its bytes are gone.
            log.warning("reservations_not_ended", reason=str(error))
            return
        with services.database.write() as connection:
            reservations.forget(connection, row)
        if time.monotonic() > until:
            return


def is_more_due(services: Services) -> bool:
    """Return whether a sweep has left blobs for the next one."""
    before = garbage_before(services.settings)
    with services.database.read() as connection:
        return connection.execute(_due(before).limit(1)).first() is not None


def garbage_before(settings: Settings) -> float:
    """Return the time (Unix seconds) since when a blob without references must have been one to be removed.

    What was sent just before the clock was set forward is not old.
    """
    return now() - settings.garbage_after_s - skipped_s(settings.garbage_after_s)


def _due(before: float) -> Select[Any]:
    return across_tenants(garbage).where(garbage.c.at < before).order_by(garbage.c.at)


def _expire(services: Services) -> None:
    settings = services.settings
    with services.database.write() as connection:
        connection.execute(delete(sessions).where(sessions.c.expires_at < now()))
        # Until then the page of a link says that it has ended, in the frames where it was shown.
        ended = now() - ENDED_SHARE_S
        connection.execute(delete(shares).where(shares.c.expires_at < ended))
        old = now() - settings.idempotency_s
        connection.execute(delete(idempotency_keys).where(idempotency_keys.c.created_at < old))
        told = now() - settings.webhook_keep_s
        connection.execute(delete(webhook_deliveries).where(webhook_deliveries.c.ended_at < told))
        # Literally, as in the condition of the index.
        is_open = scenes.c.state == literal_column("'open'")
        abandoned = across_tenants(scenes).where(is_open, scenes.c.created_at < now() - settings.open_scene_s)
        for scene in many(connection, abandoned.limit(SCENES_AT_ONCE), SceneRow):
            scene_rows.delete(connection, Tenant(scene.tenant_id), scene)


def _referenced(connection: Connection, tenant: Tenant, sha256: str) -> bool:
    return any(
        connection.execute(
            select(exists(rows(tenant, column.table, column).where(column == sha256)))
        ).scalar_one()
        for column in REFERENCES
    )


def _remove_blob(services: Services, tenant: Tenant, sha256: str, before: float) -> bool:
    """Remove an unreferenced blob, unless it was just sent again; return whether its bytes were removed."""
    mine = garbage.c.sha256 == sha256
    later = change(tenant, garbage).where(mine)
    with services.database.write() as connection:
        claimed_at = claims.lock(connection, sha256)
        if claimed_at >= before:
            # Not due before then: else it would be in the way of what is.
            connection.execute(later.values(at=claimed_at))
            return False
        # Locked before the references are counted: whoever adds one locks the blob first.
        row = rows(tenant, blobs, blobs.c.touched_at).where(blobs.c.sha256 == sha256).with_for_update()
        touched_at = connection.execute(row).scalar_one_or_none()
        if not _referenced(connection, tenant, sha256):
            if touched_at is not None and touched_at >= before:
                connection.execute(later.values(at=touched_at))
                return False
            connection.execute(remove(tenant, blobs).where(blobs.c.sha256 == sha256))
        connection.execute(remove(tenant, garbage).where(mine))
        token = claims.announce_deletion(connection, sha256)
    return token is not None and services.store.delete(services.database.write, sha256, token)
