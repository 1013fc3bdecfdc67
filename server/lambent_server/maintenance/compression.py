"""Compressed copies of bundles' files, made once and sent to every client that accepts them.

A copy is complete and on the disk before a row names it, and goes with its blob.
"""

import tempfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import structlog
from sqlalchemy import func, select, update

from lambent_server.api.problems import Problem
from lambent_server.cluster import claims
from lambent_server.database.schema import bundle_files
from lambent_server.database.tenancy import across_tenants
from lambent_server.services import Services
from lambent_server.storage.outages import TICK_S, Rounds
from lambent_server.storage.store import LOST

log = structlog.get_logger()

LEVEL = 6
MOST_SHARE = 0.95
"""A copy that is larger than this share of its file is not kept."""
_BATCH = 64
_GZIP = 31
"""Window of 32 KiB, with the header and the checksum of gzip; zlib's default adds its own instead."""


class Compressor:
    """Makes the copies that are missing after each publication, in its own thread."""

    def __init__(self, services: Services, leads: Callable[[], bool]) -> None:
        self._services = services
        self._leads = leads
        self.rounds = Rounds("compression", self._round)
        services.wakeups.listen(self.rounds.wake)

    def _round(self) -> float:
        # Signals come in bursts.
        self.rounds.pause(1.0)
        # Only one of several servers on a database, so that nothing is compressed twice.
        if self._leads():
            self.turn()
        return TICK_S

    def turn(self) -> int:
        """Decide about every file of a bundle that is not known yet; return the number of copies made."""
        num_copies = 0
        while due := _due(self._services):
            for sha256, size_bytes in due.items():
                if self._services.free_bytes() < self._services.settings.disk_floor_bytes:
                    return num_copies
                try:
                    num_copies += self._decide(sha256, size_bytes)
                except Problem as problem:
                    # The bytes are gone; the reconciler counts them.
                    log.warning("not_compressed", sha256=sha256, code=problem.code)
                    _set(self._services, sha256, LOST)
        return num_copies

    def _decide(self, sha256: str, size_bytes: int) -> bool:
        """Make the copy of a file if that pays; return whether it was made."""
        services = self._services
        if (known := _known(services, sha256)) is not None:
            _set(services, sha256, known)
            return False
        with tempfile.NamedTemporaryFile(dir=services.settings.scratch) as file:
            gzip_bytes = self._compress(sha256, size_bytes, file)
            file.flush()
            if gzip_bytes > MOST_SHARE * size_bytes:
                _set(services, sha256, 0)
                return False
            with services.database.write() as connection:
                token = claims.current(connection, sha256)
            services.store.put_copy(sha256, Path(file.name))
            if not _set(services, sha256, gzip_bytes, token):
                # The last bundle with this file was deleted meanwhile.
                services.store.delete_copy(sha256)
                return False
        return True

    def _compress(self, sha256: str, size_bytes: int, file: Any) -> int:
        packer = zlib.compressobj(LEVEL, zlib.DEFLATED, _GZIP)
        for piece in self._services.store.read(sha256, size_bytes):
            self.rounds.pause()
            file.write(packer.compress(piece))
        file.write(packer.flush())
        return int(file.tell())


def _due(services: Services) -> dict[str, int]:
    """Return the sizes of some files of which nothing is known yet, by hash."""
    # Neither sorted nor grouped: either would read all of them, which may be a million.
    statement = (
        across_tenants(bundle_files, bundle_files.c.sha256, bundle_files.c.size_bytes)
        .where(bundle_files.c.gzip_bytes.is_(None))
        .limit(_BATCH)
    )
    with services.database.read() as connection:
        return {sha256: int(size) for sha256, size in connection.execute(statement)}


def _known(services: Services, sha256: str) -> int | None:
    """Return what was decided about the same file of another bundle, or None."""
    statement = select(func.max(bundle_files.c.gzip_bytes)).where(
        bundle_files.c.sha256 == sha256, bundle_files.c.gzip_bytes >= 0
    )
    with services.database.read() as connection:
        largest = connection.execute(statement).scalar_one()
    return None if largest is None else int(largest)


def _set(services: Services, sha256: str, gzip_bytes: int, token: str | None = None) -> bool:
    """Record a decision in all bundles with the file; return whether there is any.

    With `token`, nothing is recorded if a deletion of the file began since.
    """
    statement = update(bundle_files).where(bundle_files.c.sha256 == sha256).values(gzip_bytes=gzip_bytes)
    with services.database.write() as connection:
        if token is not None and not claims.still_held(connection, sha256, token):
            return False
        return connection.execute(statement).rowcount > 0
