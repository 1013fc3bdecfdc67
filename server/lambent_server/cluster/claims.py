"""Claims: which process may write or delete the bytes of a hash, also among servers on one database.

A writer claims the hash, writes, and adds its row only if no deletion began meanwhile; otherwise it writes
again. A deletion first commits that no row is left and that it began, and then deletes the bytes while it
holds the lock on the claim, unless a writer has claimed the hash again. A process may be killed at any
point: a claim that stays behind as "deleting" is finished by the next sweep. Rows of `blobs` are added and
removed under the lock only, and the claim is locked before any of them.
"""

from typing import Any

from sqlalchemy import Connection, Row, delete, select, update

from lambent_server.core.clock import new_id, now
from lambent_server.database.cluster_schema import blob_claims
from lambent_server.database.columns import insert_or
from lambent_server.database.schema import blobs, garbage
from lambent_server.database.tenancy import Tenant, across_tenants, remove

KEPT = "kept"
DELETING = "deleting"


def claim(connection: Connection, tenant: Tenant, sha256: str) -> str:
    """Claim a hash in order to write its bytes, and return the token to show afterwards.

    Waits for a deletion in progress and cancels one that was only announced. The tenant's blob is no longer
    garbage.
    """
    row = _lock(connection, sha256)
    mine = update(blob_claims).where(blob_claims.c.sha256 == sha256)
    connection.execute(mine.values(state=KEPT, claimed_at=now()))
    connection.execute(remove(tenant, garbage).where(garbage.c.sha256 == sha256))
    return str(row.token)


def still_held(connection: Connection, sha256: str, token: str) -> bool:
    """Return whether no deletion began since the claim; until the transaction ends, none can."""
    row = _find(connection, sha256)
    return row is not None and row.token == token


def lock(connection: Connection, sha256: str) -> float:
    """Lock a hash, for `announce_deletion` or its compressed copy; return when it was claimed last."""
    return float(_lock(connection, sha256).claimed_at)


def current(connection: Connection, sha256: str) -> str:
    """Return the token to show `still_held`, for bytes that belong to those of the hash."""
    return str(_lock(connection, sha256).token)


def interrupt(connection: Connection, sha256: str) -> None:
    """Lock a hash and let whoever is writing its bytes write them again."""
    row = _lock(connection, sha256)
    if row.state == KEPT:
        mine = update(blob_claims).where(blob_claims.c.sha256 == sha256)
        connection.execute(mine.values(token=new_id("claim")))


def announce_deletion(connection: Connection, sha256: str) -> str | None:
    """Return the token of a deletion that begins with this transaction, or None if a tenant has the blob."""
    anybody = across_tenants(blobs, blobs.c.sha256).where(blobs.c.sha256 == sha256)
    if connection.execute(anybody.limit(1)).first() is not None:
        return None
    token = new_id("claim")
    mine = update(blob_claims).where(blob_claims.c.sha256 == sha256)
    connection.execute(mine.values(state=DELETING, token=token))
    return token


def lock_deletion(connection: Connection, sha256: str, token: str) -> bool:
    """Lock an announced deletion; return False if a writer has claimed the hash again, or finished it."""
    row = _find(connection, sha256)
    return row is not None and row.state == DELETING and row.token == token


def end_deletion(connection: Connection, sha256: str) -> None:
    """Forget the claim on bytes that are gone."""
    connection.execute(delete(blob_claims).where(blob_claims.c.sha256 == sha256))


def announced(connection: Connection) -> list[tuple[str, str]]:
    """Return hash and token of the deletions that began and have not ended."""
    statement = select(blob_claims.c.sha256, blob_claims.c.token).where(blob_claims.c.state == DELETING)
    return [(sha256, token) for sha256, token in connection.execute(statement)]


def _lock(connection: Connection, sha256: str) -> Row[Any]:
    """Return the claim on a hash, locked until the end of the transaction; made if there is none."""
    values = {"sha256": sha256, "state": KEPT, "token": new_id("claim"), "claimed_at": 0.0}
    while True:
        connection.execute(insert_or(connection, blob_claims).values(values).on_conflict_do_nothing())
        row = _find(connection, sha256)
        # Between the two a deletion may have ended.
        if row is not None:
            return row


def _find(connection: Connection, sha256: str) -> Row[Any] | None:
    statement = select(blob_claims).where(blob_claims.c.sha256 == sha256).with_for_update()
    return connection.execute(statement).one_or_none()
