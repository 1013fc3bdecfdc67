"""Repair after crashes and disk failures: bytes without a database row, and rows whose bytes are gone."""

import shutil
import threading
from collections.abc import Iterable
from pathlib import Path

import structlog
from sqlalchemy import ColumnElement, Connection, and_, delete, exists, func, select, update
from sqlalchemy.exc import SQLAlchemyError

from lambent_server.clock import now
from lambent_server.database.schema import (
    api_keys,
    artifacts,
    blobs,
    bundle_files,
    checkpoint_files,
    environments,
    jobs,
    scene_files,
    scenes,
)
from lambent_server.database.tenancy import across_tenants
from lambent_server.services import Services

log = structlog.get_logger()

TICK_S = 60.0
_PREFIXES = tuple(f"{number:02x}" for number in range(256))


class Reconciler:
    """Compares database and store at startup and then every `reconcile_s`, in its own thread."""

    def __init__(self, services: Services) -> None:
        self._services = services
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._loop, name="reconciler", daemon=True)
        self.num_missing = 0
        """Files of scenes, bundles and jobs whose bytes are gone."""

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def close(self) -> None:
        """Stop, and store when keys were last used."""
        self._stopping.set()
        self._thread.join(timeout=1)

    def _loop(self) -> None:
        looked_at = 0.0
        while True:
            stopping = self._stopping.is_set()
            try:
                note_key_uses(self._services)
                if not stopping and now() - looked_at >= self._services.settings.reconcile_s:
                    looked_at = now()
                    self.num_missing = reconcile(self._services)
            except (SQLAlchemyError, OSError):
                # The database or the disk is unavailable; the next round finds the same.
                log.exception("reconcile_failed")
            if stopping:
                return
            self._stopping.wait(TICK_S)


def note_key_uses(services: Services) -> None:
    """Store when keys were used since the last call."""
    if not services.key_uses:
        return
    with services.database.write() as connection:
        while services.key_uses:
            key_id, at = services.key_uses.popitem()
            connection.execute(update(api_keys).where(api_keys.c.id == key_id).values(last_used_at=at))


def reconcile(services: Services) -> int:
    """Remove unreachable bytes and forget blobs whose bytes are gone; return how many files lack their bytes.

    Anything younger than `orphan_after_s` may be an upload in progress and is kept. A blob whose bytes are
    gone is forgotten, so that the next upload sends it again; rows that refer to it stay.
    """
    before = now() - services.settings.orphan_after_s
    removed = sum(_compare(services, prefix, before) for prefix in _PREFIXES)
    _remove_folders(services, before)
    with services.database.read() as connection:
        missing = _count_missing(connection)
    if removed or missing:
        log.warning("reconciled", blobs_removed=removed, files_missing=missing)
    return missing


def _compare(services: Services, prefix: str, before: float) -> int:
    """Compare rows and bytes of the blobs whose hashes begin with `prefix`; return how many were removed."""
    of_prefix = and_(blobs.c.sha256 >= prefix, blobs.c.sha256 < prefix + "g")
    # Rows first: bytes that arrive meanwhile have a row that is not known here, and are young.
    rows = _sizes(services, of_prefix)
    files = services.store.listed(prefix)
    lost = [sha256 for sha256, size in rows.items() if files.get(sha256, (-1, 0.0))[0] != size]
    orphans = [sha256 for sha256, (_, at) in files.items() if sha256 not in rows and at < before]
    if not lost and not orphans:
        return 0
    with services.store.lock:
        files, rows = services.store.listed(prefix), _sizes(services, of_prefix)
        for sha256 in lost:
            size = files.get(sha256, (-1, 0.0))[0]
            if sha256 in rows and size != rows[sha256]:
                log.error("blob_lost", sha256=sha256, expected_bytes=rows[sha256], found_bytes=max(size, 0))
                with services.database.write() as connection:
                    connection.execute(delete(blobs).where(blobs.c.sha256 == sha256))
                orphans.append(sha256)
                del rows[sha256]
        unnamed = [sha256 for sha256 in orphans if sha256 in files and sha256 not in rows]
        for sha256 in unnamed:
            services.store.delete(sha256)
    return len(unnamed)


def _sizes(services: Services, condition: ColumnElement[bool]) -> dict[str, int]:
    with services.database.read() as connection:
        found = connection.execute(across_tenants(blobs, blobs.c.sha256, blobs.c.size_bytes).where(condition))
        return {sha256: int(size) for sha256, size in found}


def _remove_folders(services: Services, before: float) -> None:
    """Remove interrupted uploads, incomplete blobs, and the folders of deleted jobs."""
    settings = services.settings
    partial = (settings.data / "store").glob("blobs/??/*#*") if settings.store is None else ()
    for path in _older((*settings.scratch.iterdir(), *partial), before):
        shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)
    folders = list(_older(settings.runs.iterdir(), before))
    with services.database.read() as connection:
        known = set(connection.execute(across_tenants(jobs, jobs.c.id)).scalars())
    for folder in folders:
        if folder.name not in known:
            shutil.rmtree(folder)


def _older(paths: Iterable[Path], before: float) -> Iterable[Path]:
    return (path for path in paths if path.exists() and path.stat().st_mtime < before)


def _count_missing(connection: Connection) -> int:
    """Return how many files that were complete no longer have a blob."""
    is_open = exists().where(scenes.c.id == scene_files.c.scene_id, scenes.c.state == "open")
    count = 0
    for table in (scene_files, checkpoint_files, artifacts, bundle_files, environments):
        known = exists().where(blobs.c.tenant_id == table.c.tenant_id, blobs.c.sha256 == table.c.sha256)
        statement = select(func.count()).select_from(table).where(~known)
        if table is scene_files:
            statement = statement.where(~is_open)
        count += connection.execute(statement).scalar_one()
    return count
