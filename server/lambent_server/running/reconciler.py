"""Repair after crashes and disk failures: bytes without a database row, and rows whose bytes are gone."""

import shutil
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import structlog
from sqlalchemy import Column, ColumnElement, Select, and_, exists, update
from sqlalchemy.exc import SQLAlchemyError

from lambent_server.cluster import claims
from lambent_server.core.clock import now, skipped_s
from lambent_server.core.settings import Settings
from lambent_server.database.schema import api_keys, blobs, bundle_files, garbage, jobs
from lambent_server.database.tenancy import Tenant, across_tenants
from lambent_server.maintenance import retention
from lambent_server.maintenance.housekeeping import REFERENCES
from lambent_server.receiving.direct import FOLDER
from lambent_server.services import Services
from lambent_server.storage.content_checks import GZIP
from lambent_server.storage.outages import TICK_S, Rounds, report
from lambent_server.storage.store import LOST, discard, file_time

log = structlog.get_logger()

_PREFIXES = tuple(f"{number:02x}" for number in range(256))
_FOLDERS_AT_ONCE = 500
_EXAMPLES = 10
_FEW = 16
"""So many unknown blobs are always removed: a small store may consist of them."""


class Reconciler:
    """Compares database and store at startup and then every `reconcile_s`, in its own thread.

    Of several servers on a database, the leader does so; each looks after its own folders.
    """

    def __init__(self, services: Services, leads: Callable[[], bool] = lambda: True) -> None:
        self._services = services
        self._leads = leads
        self._rounds = Rounds("reconcile", self._round)
        self._looked_at = float("-inf")
        self.start = self._rounds.start
        self.num_missing = 0
        """Blobs that rows name and whose bytes are gone or not whole."""

    def close(self) -> None:
        """Stop, and store when keys were last used."""
        self._rounds.close(1.0)
        try:
            note_key_uses(self._services)
        except (SQLAlchemyError, OSError) as error:
            report("reconcile_failed", error)

    def _round(self) -> float:
        note_key_uses(self._services)
        if time.monotonic() - self._looked_at >= self._services.settings.reconcile_s:
            self._looked_at = time.monotonic()
            self._services.database.analyze()
            if self._leads():
                retention.enforce(self._services)
                self.num_missing = reconcile(self._services)
            else:
                self.num_missing = 0
                retention.enforce(self._services, only_logs=True)
                remove_folders(self._services)
        return TICK_S


def note_key_uses(services: Services) -> None:
    """Store when keys were used since the last call."""
    if not services.key_uses:
        return
    with services.database.write() as connection:
        while services.key_uses:
            key_id, at = services.key_uses.popitem()
            connection.execute(update(api_keys).where(api_keys.c.id == key_id).values(last_used_at=at))


@dataclass(slots=True)
class Findings:
    """How database and store differ."""

    num_blobs: int = 0
    """Blobs in the store."""
    unknown: dict[str, int] = field(default_factory=dict)
    """Hashes of bytes without a row, with their sizes."""
    lost: list[str] = field(default_factory=list)
    """Hashes that rows name and whose bytes are missing or truncated."""
    unreferenced: list[tuple[str, str]] = field(default_factory=list)
    """Tenants and hashes of rows that nothing refers to: files of uploads and runs that were broken off."""
    staged: list[str] = field(default_factory=list)
    """Names of files that were sent to the store directly and never taken over."""
    damaged: list[str] = field(default_factory=list)
    """Hashes of bytes that are whole and do not match them; found only where contents are read."""
    parts: list[tuple[str, str]] = field(default_factory=list)
    """Names and ids of uploads in parts that were never completed."""

    @property
    def is_foreign(self) -> bool:
        """Whether the database knows less than half of the store, and so probably belongs to another one."""
        return len(self.unknown) > max(_FEW, self.num_blobs // 2)

    @property
    def num_orphans(self) -> int:
        """How much can be removed."""
        return len(self.unknown) + len(self.unreferenced) + len(self.staged) + len(self.parts)


def old_before(settings: Settings) -> float:
    """Return the time (Unix seconds) before which rows without references are of no upload in progress."""
    return now() - settings.orphan_after_s - skipped_s(settings.orphan_after_s)


def old_files_before(settings: Settings, file_time: float) -> float:
    """Return the same for files, by the clock of the file system or store that they are on.

    That may be another machine's, and is not slowed where it was set back; `file_time` is what it shows.
    """
    return file_time - settings.orphan_after_s - skipped_s(settings.orphan_after_s)


def reconcile(services: Services) -> int:
    """Remove what is left over; return the number of blobs whose bytes are missing or truncated.

    Rows of missing bytes are kept: a store that was not mounted may return, and the next upload writes
    missing bytes again. Nothing is removed if the database knows less than half of the store.
    """
    findings = examine(services)
    if findings.is_foreign:
        log.error("reconcile_refused", blobs_unknown=len(findings.unknown), blobs=findings.num_blobs)
    else:
        repair(services, findings)
        _reconcile_copies(services, old_files_before(services.settings, services.store.file_time()))
        _compress_again(services, set(findings.lost))
        remove_folders(services)
    if findings.num_orphans or findings.lost:
        log.warning(
            "reconciled",
            blobs_unknown=len(findings.unknown),
            blobs_unreferenced=len(findings.unreferenced),
            uploads_abandoned=len(findings.staged) + len(findings.parts),
            blobs_lost=len(findings.lost),
            examples=findings.lost[:_EXAMPLES],
        )
    return len(findings.lost)


def examine(services: Services, *, contents: bool = False) -> Findings:
    """Return how database and store differ, and change nothing; with `contents` all bytes are read.

    Anything younger than `orphan_after_s` may be an upload in progress and is left out.
    """
    before = old_files_before(services.settings, services.store.file_time())
    findings = Findings()
    for prefix in _PREFIXES:
        # Rows first: bytes that come meanwhile have a row that is not known here, and are young.
        rows, files = _sizes(services, prefix), services.store.listed(prefix)
        findings.num_blobs += len(files)
        lost = {sha256 for sha256, size in rows.items() if files.get(sha256, (-1, 0.0))[0] != size}
        findings.lost += sorted(lost)
        if contents:
            matches = services.store.checks.matches
            findings.damaged += [sha256 for sha256 in sorted(set(rows) - lost) if not matches(sha256)]
        for sha256, (size, at) in files.items():
            if sha256 not in rows and at < before:
                findings.unknown[sha256] = size
    findings.unreferenced = _unreferenced(services, old_before(services.settings))
    bucket = services.store.bucket
    if bucket is not None:
        findings.staged = [key for key, _, at in bucket.listed(f"{FOLDER}/") if at < before]
        findings.parts = [
            (key, upload_id) for key, upload_id, at in bucket.uploads(f"{FOLDER}/") if at < before
        ]
    return findings


def repair(services: Services, findings: Findings) -> None:
    """Remove what is left over, unless it is needed by now."""
    before = old_before(services.settings)
    for sha256 in findings.unknown:
        remove_orphan(services, sha256, before)
    with services.database.write() as connection:
        # The sweep checks once more that nothing refers to them.
        for tenant, sha256 in findings.unreferenced:
            discard(connection, Tenant(tenant), sha256)
    bucket = services.store.bucket
    if bucket is not None:
        for key in findings.staged:
            bucket.delete(key)
        for key, upload_id in findings.parts:
            bucket.abort(key, upload_id)


def _unreferenced(services: Services, before: float) -> list[tuple[str, str]]:
    """Return tenant and hash of old rows that nothing refers to and that are not known as garbage yet."""
    columns = (blobs.c.tenant_id, blobs.c.sha256)
    statement = across_tenants(blobs, *columns).where(blobs.c.touched_at < before)
    for column in (*REFERENCES, garbage.c.sha256):
        mine = (column == blobs.c.sha256) & (column.table.c.tenant_id == blobs.c.tenant_id)
        statement = statement.where(~exists().where(mine))
    with services.database.read() as connection:
        return [(tenant, sha256) for tenant, sha256 in connection.execute(statement)]


def remove_orphan(services: Services, sha256: str, before: float) -> bool:
    """Remove bytes that no row names, unless they are just being sent."""
    write = services.database.write
    with write() as connection:
        if claims.lock(connection, sha256) >= before:
            return False
        token = claims.announce_deletion(connection, sha256)
    return token is not None and services.store.delete(write, sha256, token)


def _sizes(services: Services, prefix: str) -> dict[str, int]:
    """Return the sizes of the blobs that rows name, of hashes that begin with `prefix`."""
    named = across_tenants(blobs, blobs.c.sha256, blobs.c.size_bytes).where(_begins(blobs.c.sha256, prefix))
    with services.database.read() as connection:
        return {sha256: int(size) for sha256, size in connection.execute(named)}


def _begins(sha256: Column[str], prefix: str) -> ColumnElement[bool]:
    return and_(sha256 >= prefix, sha256 < prefix + "g")


def _reconcile_copies(services: Services, before: float) -> None:
    """Remove old compressed copies that no row names; forget lost ones, so that they are made again."""
    for prefix in _PREFIXES:
        with services.database.read() as connection:
            rows = {sha256: int(size) for sha256, size in connection.execute(_named_copies(prefix))}
        files = services.store.listed(prefix, GZIP)
        lost = [sha256 for sha256, size in rows.items() if files.get(sha256, (-1, 0.0))[0] != size]
        _forget_copies(services, lost)
        for sha256, (_, at) in files.items():
            if sha256 in rows or at >= before:
                continue
            with services.database.write() as connection:
                claims.lock(connection, sha256)
                if connection.execute(_named_copies(sha256)).first() is None:
                    services.store.delete_copy(sha256)


def _compress_again(services: Services, lost: set[str]) -> None:
    """Forget which files could not be compressed because their bytes were gone, where these are back."""
    sha256, is_lost = bundle_files.c.sha256, bundle_files.c.gzip_bytes == LOST
    for prefix in _PREFIXES:
        statement = across_tenants(bundle_files, sha256).where(_begins(sha256, prefix), is_lost).distinct()
        with services.database.read() as connection:
            back = [each for each in connection.execute(statement).scalars() if each not in lost]
        _forget_copies(services, back, is_lost)


def _forget_copies(services: Services, hashes: Iterable[str], *conditions: ColumnElement[bool]) -> None:
    """Let it be decided again whether these files are compressed."""
    for sha256 in hashes:
        statement = update(bundle_files).where(bundle_files.c.sha256 == sha256, *conditions)
        with services.database.write() as connection:
            connection.execute(statement.values(gzip_bytes=None))


def _named_copies(prefix: str) -> Select[Any]:
    """Return the query of hash and size of the copies that rows name, of hashes that begin with `prefix`."""
    sha256, size = bundle_files.c.sha256, bundle_files.c.gzip_bytes
    return across_tenants(bundle_files, sha256, size).where(_begins(sha256, prefix), size > 0)


def remove_folders(services: Services) -> None:
    """Remove interrupted uploads, incomplete blobs, and the folders of deleted jobs."""
    settings = services.settings
    before = old_files_before(settings, file_time(settings.scratch))
    partial = (settings.data / "store").glob("*/??/*#*") if settings.store is None else ()
    for path in _older((*settings.scratch.iterdir(), *partial), before):
        shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)
    folders = list(_older(settings.runs.iterdir(), before))
    for start in range(0, len(folders), _FOLDERS_AT_ONCE):
        some = {folder.name: folder for folder in folders[start : start + _FOLDERS_AT_ONCE]}
        with services.database.read() as connection:
            known = across_tenants(jobs, jobs.c.id).where(jobs.c.id.in_(some))
            gone = set(some) - set(connection.execute(known).scalars())
        for name in gone:
            shutil.rmtree(some[name])


def _older(paths: Iterable[Path], before: float) -> Iterable[Path]:
    return (path for path in paths if path.exists() and path.stat().st_mtime < before)
