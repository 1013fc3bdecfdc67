"""A slow reader of everything in the store, which finds damaged bytes before they are needed."""

import time
from collections.abc import Callable, Sequence

import structlog
from sqlalchemy import func, select, update

from lambent_server.cluster.claims import KEPT
from lambent_server.core.clock import now
from lambent_server.database.cluster_schema import blob_claims
from lambent_server.database.schema import blobs
from lambent_server.services import Services
from lambent_server.storage.content_checks import BLOBS, GZIP
from lambent_server.storage.outages import TICK_S, Rounds, Stopped

log = structlog.get_logger()

AT_ONCE = 100
_LEAST_SLEEP_S = 0.02


class Scrubber:
    """Compares every blob with its hash again and again, in its own thread of the leader.

    What was not checked for longest comes first; a new blob has never been.
    """

    def __init__(self, services: Services, leads: Callable[[], bool]) -> None:
        self._services = services
        self._leads = leads
        self._debt_s = 0.0
        self.rounds = Rounds("scrub", self._round)

    def _round(self) -> float:
        if not self._services.settings.scrub_bytes_per_s:
            raise Stopped
        return 0.0 if self._leads() and self.turn() else TICK_S

    def turn(self) -> Sequence[tuple[str, int]]:
        """Check some blobs that are due, and return their hashes and sizes."""
        blobs_due = due(self._services)
        checks = self._services.store.checks
        for sha256, size_bytes in blobs_due:
            checks.scrub(sha256, size_bytes, BLOBS, self._pace)
            copy = checks.version(sha256, GZIP)
            if copy is not None:
                checks.scrub(sha256, copy.size_bytes, GZIP, self._pace)
            # Also of one whose bytes are missing: that is for the reconciler.
            with self._services.database.write() as connection:
                mine = update(blob_claims).where(blob_claims.c.sha256 == sha256)
                connection.execute(mine.values(checked_at=now()))
        return blobs_due

    def _pace(self, num_bytes: int) -> None:
        """Wait as long as so many bytes take at the rate of the settings."""
        self._debt_s += num_bytes / self._services.settings.scrub_bytes_per_s
        if self._debt_s >= _LEAST_SLEEP_S:
            began = time.monotonic()
            self.rounds.pause(self._debt_s)
            self._debt_s = max(self._debt_s - (time.monotonic() - began), 0.0)


def due(services: Services) -> Sequence[tuple[str, int]]:
    """Return hash and size of at most `AT_ONCE` blobs whose last check is as old as the settings say."""
    before = now() - services.settings.scrub_every_s
    size = func.max(blobs.c.size_bytes)
    oldest = (
        select(blob_claims.c.sha256)
        .where(blob_claims.c.checked_at < before, blob_claims.c.state == KEPT)
        .order_by(blob_claims.c.checked_at)
        .limit(AT_ONCE)
        .subquery()
    )
    statement = select(blobs.c.sha256, size).where(blobs.c.sha256.in_(select(oldest.c.sha256)))
    with services.database.read() as connection:
        sizes = connection.execute(statement.group_by(blobs.c.sha256)).all()
    return [(sha256, int(num_bytes)) for sha256, num_bytes in sizes]
