"""Repair after crashes and disk failures: bytes without a database row, and rows whose bytes are gone."""

import shutil
import threading
from collections.abc import Iterable
from pathlib import Path

import structlog
from sqlalchemy import and_, update
from sqlalchemy.exc import SQLAlchemyError

from lambent_server.clock import now
from lambent_server.database.schema import (
    api_keys,
    blobs,
    jobs,
)
from lambent_server.database.tenancy import across_tenants
from lambent_server.services import Services

log = structlog.get_logger()

TICK_S = 60.0
_PREFIXES = tuple(f"{number:02x}" for number in range(256))
_FEW = 16
"""So many unknown blobs are always removed: a small store may consist of them."""


class Reconciler:
    """Compares database and store at startup and then every `reconcile_s`, in its own thread."""

    def __init__(self, services: Services) -> None:
        self._services = services
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._loop, name="reconciler", daemon=True)
        self.num_missing = 0
        """Blobs that rows name and whose bytes are gone or not whole."""

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
    """Remove bytes and folders without rows; return the number of blobs whose bytes are missing or truncated.

    Anything younger than `orphan_after_s` may be an upload in progress and is kept. Rows of missing bytes are
    kept: a store that was not mounted may return, and the next upload writes missing bytes again. Nothing is
    removed if the database knows less than half of the store, because it probably belongs to another store.
    """
    before = now() - services.settings.orphan_after_s
    num_files, orphans, lost = 0, [], []
    for prefix in _PREFIXES:
        # Rows first: bytes that come meanwhile have a row that is not known here, and are young.
        rows, files = _sizes(services, prefix), services.store.listed(prefix)
        num_files += len(files)
        lost += [sha256 for sha256, size in rows.items() if files.get(sha256, (-1, 0.0))[0] != size]
        orphans += [sha256 for sha256, (_, at) in files.items() if sha256 not in rows and at < before]
    if len(orphans) > max(_FEW, num_files // 2):
        log.error("reconcile_refused", blobs_unknown=len(orphans), blobs=num_files)
    else:
        for sha256 in orphans:
            with services.store.lock:
                if sha256 not in _sizes(services, sha256):
                    services.store.delete(sha256)
        _remove_folders(services, before)
    if orphans or lost:
        log.warning("reconciled", blobs_unknown=len(orphans), blobs_lost=len(lost), examples=lost[:10])
    return len(lost)


def _sizes(services: Services, prefix: str) -> dict[str, int]:
    """Return the sizes of the blobs that rows name, of hashes that begin with `prefix`."""
    condition = and_(blobs.c.sha256 >= prefix, blobs.c.sha256 < prefix + "g")
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
