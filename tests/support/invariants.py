"""Promises of a service at rest, whatever happened to it: P1 to P7 in its database and store.

`broken` returns a line for each thing that does not hold. It expects that no job is unfinished and that no
sweep is due.
"""

import hashlib
from collections.abc import Collection, Iterable
from pathlib import Path
from typing import Any

from lambent_server.api.problems import Problem
from lambent_server.maintenance.housekeeping import REFERENCES
from lambent_server.storage.store import BLOBS, BlobStore
from sqlalchemy import Connection, text

_FINAL = "('succeeded', 'failed', 'cancelled')"
# Each query finds what must not exist.
QUERIES = {
    "P2 trained and not exactly one bundle": """
        SELECT id FROM jobs WHERE kind = 'train' AND state = 'succeeded'
        AND (SELECT count(*) FROM bundles WHERE bundles.job_id = jobs.id) <> 1""",
    "P2 a bundle of a job that did not succeed": """
        SELECT bundles.id FROM bundles LEFT JOIN jobs ON jobs.id = bundles.job_id
        WHERE jobs.id IS NULL OR jobs.state <> 'succeeded' OR jobs.bundle_id <> bundles.id""",
    "P2 ended more than once": f"""
        SELECT job_id FROM events WHERE type = 'state' AND state IN {_FINAL}
        GROUP BY job_id HAVING count(*) > 1""",
    "P2 one run begun twice": """
        SELECT job_id FROM events WHERE type = 'state' AND state = 'running'
        GROUP BY job_id, run HAVING count(*) > 1""",
    "P2 events missing": """
        SELECT jobs.id FROM jobs WHERE event_seq <> (SELECT count(*) FROM events WHERE job_id = jobs.id)
        OR event_seq <> (SELECT max(seq) FROM events WHERE job_id = jobs.id)""",
    "P3 a checkpoint that is older than the one before": """
        SELECT later.id FROM checkpoints later JOIN checkpoints earlier
        ON earlier.job_id = later.job_id AND earlier.stage = later.stage
        WHERE earlier.number < later.number AND earlier.step > later.step""",
    "P4 ended and yet something happened": f"""
        SELECT later.job_id FROM events ended JOIN events later
        ON later.job_id = ended.job_id AND later.seq > ended.seq
        WHERE ended.type = 'state' AND ended.state IN {_FINAL} AND later.type IN ('state', 'checkpoint')""",
    "P4 ended without a time or with a process": f"""
        SELECT id FROM jobs WHERE state IN {_FINAL} AND (finished_at IS NULL OR handle IS NOT NULL)""",
    "P4 the history ends with another state": f"""
        SELECT id FROM jobs WHERE state IN {_FINAL} AND state <> (SELECT state FROM events
        WHERE job_id = jobs.id AND type = 'state' ORDER BY seq DESC LIMIT 1)""",
    "P5 a bundle without files": """
        SELECT id FROM bundles WHERE NOT EXISTS (SELECT 1 FROM bundle_files WHERE bundle_id = bundles.id)""",
    "P6 a bundle of another tenant": """
        SELECT bundles.id FROM bundles JOIN jobs ON jobs.id = bundles.job_id
        WHERE bundles.tenant_id <> jobs.tenant_id""",
    "P6 a file of a bundle of another tenant": """
        SELECT bundles.id FROM bundle_files JOIN bundles ON bundles.id = bundle_files.bundle_id
        WHERE bundles.tenant_id <> bundle_files.tenant_id""",
    "P6 an event of another tenant": """
        SELECT jobs.id FROM events JOIN jobs ON jobs.id = events.job_id
        WHERE jobs.tenant_id <> events.tenant_id""",
    "P6 a job on the scene of another tenant": """
        SELECT jobs.id FROM jobs JOIN scenes ON scenes.id = jobs.scene_id
        WHERE jobs.tenant_id <> scenes.tenant_id""",
    "counts of jobs": """
        SELECT tenant_id, state, sum(n) FROM (
            SELECT tenant_id, state, count(*) AS n FROM jobs GROUP BY tenant_id, state
            UNION ALL SELECT tenant_id, state, -num_jobs FROM job_counts) AS both_kinds
        GROUP BY tenant_id, state HAVING sum(n) <> 0""",
    "deletions that did not end": "SELECT sha256 FROM blob_claims WHERE state <> 'kept'",
}
_EXAMPLES = 5
# Ends the names of two messages, of requests and of calls of run processes.
_UNEXPECTED = 'request_failed"'


def broken(
    connection: Connection, store: BlobStore, accepted: Iterable[str], logs: Iterable[Path] = ()
) -> list[str]:
    """Return what does not hold, with at most five examples each.

    `accepted` are the jobs that were answered with 202, `logs` those of the servers.
    """
    found: dict[str, Collection[Any]] = {
        name: connection.execute(text(query)).fetchall() for name, query in QUERIES.items()
    }
    known = set(connection.execute(text("SELECT id FROM jobs")).scalars())
    found["P1 accepted and lost"] = sorted(set(accepted) - known)
    found |= _missing_bytes(connection, store)
    found["P7 an unexpected error of the server"] = [
        line[:300] for path in logs for line in path.read_text().splitlines() if _UNEXPECTED in line
    ]
    return [f"{name}: {list(some)[:_EXAMPLES]}" for name, some in found.items() if some]


def _missing_bytes(connection: Connection, store: BlobStore) -> dict[str, Collection[Any]]:
    """Return references to blobs that are not there or not whole, and bytes that nothing refers to."""
    found: dict[str, Collection[Any]] = {}
    for column in REFERENCES:
        name = f"{column.table.name}.{column.name}"
        query = f"""SELECT {name} FROM {column.table.name} WHERE {name} <> '' AND NOT EXISTS
            (SELECT 1 FROM blobs WHERE blobs.sha256 = {name}
            AND blobs.tenant_id = {column.table.name}.tenant_id)"""
        found[f"P5 {name} without a blob"] = connection.execute(text(query)).fetchall()
    sizes = dict(connection.execute(text("SELECT sha256, size_bytes FROM blobs")).all())  # type: ignore[arg-type]
    there = store.listed("", BLOBS)
    found["P5 a blob without its bytes"] = sorted(set(sizes) - set(there))
    both = sorted(set(sizes) & set(there))
    found["P5 a blob that is not whole"] = [
        each for each in both if not _is_whole(store, each, int(sizes[each]))
    ]
    found["bytes without a blob"] = sorted(set(there) - set(sizes))
    return found


def _is_whole(store: BlobStore, sha256: str, size_bytes: int) -> bool:
    digest = hashlib.sha256()
    try:
        for chunk in store.read(sha256, size_bytes):
            digest.update(chunk)
    except Problem:
        # Of another size.
        return False
    return digest.hexdigest() == sha256
