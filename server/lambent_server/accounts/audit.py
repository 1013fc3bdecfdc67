"""The audit log: one chain of entries per organisation, to which entries are only added.

The hash of an entry covers the hash of the one before, so that a change, a gap or a removed end is noticed
by `verify`. The database refuses changes and removals; only `remove_before` may remove the oldest entries.
Call `record` as the last thing in a transaction: until it ends, no other entry of the organisation is added.
"""

import hashlib
import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from typing import Any

from pydantic import JsonValue
from sqlalchemy import Connection, select

from lambent_server.accounts.who import Who
from lambent_server.api.problems import Problem
from lambent_server.core.clock import now
from lambent_server.database.engine import Database
from lambent_server.database.model import AuditHeadRow, AuditRow
from lambent_server.database.people_schema import audit_entries, audit_heads, audit_permits
from lambent_server.database.people_schema import organisations as organisation_rows
from lambent_server.database.rows import many, one
from lambent_server.database.tenancy import Tenant, add, add_if_absent, change, remove, rows

DONE = "done"
SERVER = Tenant("")
"""The owner of entries that belong to no organisation: unknown people, deleted organisations."""
_BATCH = 1000
_HASHED = ("number", "at", "actor_kind", "actor_id", "action", "target", "address", "request_id")
_MAX_TEXT = 200


@dataclass(frozen=True, kw_only=True, slots=True)
class Verdict:
    """Whether a chain is whole."""

    num_entries: int
    number: int
    """Of the newest entry; 0 if there never was one."""
    hash: str
    """Of the newest entry. Note it elsewhere: a person who can rewrite the database can rewrite a chain."""
    problem: str = ""
    """What is wrong with which entry; "" if nothing is."""


def record(
    connection: Connection,
    who: Who,
    action: str,
    target: str = "",
    *,
    outcome: str = DONE,
    details: Mapping[str, JsonValue] | None = None,
) -> None:
    """Add an entry to the log of the organisation of `who`.

    Raises `not_authenticated` if the organisation is closed, or deleted, by now: that rolls back what the
    entry tells. Operators may act on a closed one.
    """
    head = _lock_head(connection, who.tenant)
    _require_open(connection, who)
    number = head.number + 1
    entry: dict[str, Any] = {
        "number": number,
        "at": now(),
        "actor_kind": who.kind,
        "actor_id": who.id,
        "action": action,
        "target": target[:_MAX_TEXT],
        "address": who.address[:_MAX_TEXT],
        "request_id": who.request_id,
        "outcome": outcome,
        "details": json.dumps(details or {}, sort_keys=True, separators=(",", ":")),
    }
    digest = _digest(head.hash, who.tenant, entry)
    connection.execute(add(who.tenant, audit_entries, id=entry_id(number), hash=digest, **entry))
    connection.execute(change(who.tenant, audit_heads).values(number=number, hash=digest))


@contextmanager
def recorded(database: Database, who: Who, action: str, target: str = "") -> Iterator[Connection]:
    """Open a transaction in which `who` does something, and record it at the end."""
    with database.write() as connection:
        yield connection
        record(connection, who, action, target)


def entry_id(number: int) -> str:
    """Return the id of the entry with this number."""
    return f"audit_{number:012d}"


def lock(connection: Connection, tenant: Tenant) -> None:
    """Let nobody else record anything in an organisation, and so change anything, before this has ended."""
    _lock_head(connection, tenant)


def _require_open(connection: Connection, who: Who) -> None:
    """Raise a Problem unless the organisation of `who` exists, and is open or `who` an operator.

    With the head of its log locked: who closes or deletes an organisation holds that until it is done.
    """
    if who.tenant == SERVER:
        return
    closed_at = rows(who.tenant, organisation_rows, organisation_rows.c.closed_at)
    row = connection.execute(closed_at).one_or_none()
    if row is None or (row[0] is not None and who.kind != "operator"):
        raise Problem(
            401,
            "not_authenticated",
            f"the organisation {who.tenant.id!r} has just been closed; sign in to another one",
            headers={"www-authenticate": 'Bearer realm="lambent"'},
        )


def _lock_head(connection: Connection, tenant: Tenant) -> AuditHeadRow:
    """Return the head of a chain, locked until the end of the transaction; made if there is none."""
    statement = rows(tenant, audit_heads).with_for_update()
    head = one(connection, statement, AuditHeadRow)
    if head is None:
        empty = {"number": 0, "hash": "", "removed_number": 0, "removed_hash": ""}
        add_if_absent(connection, tenant, audit_heads, **empty)
        (head,) = many(connection, statement, AuditHeadRow)
    return head


def _digest(before: str, tenant: Tenant, entry: Mapping[str, Any]) -> str:
    values = [before, tenant.id, *(entry[name] for name in (*_HASHED, "outcome", "details"))]
    return hashlib.sha256(json.dumps(values, separators=(",", ":")).encode()).hexdigest()


def verify(connection: Connection, tenant: Tenant) -> Verdict:
    """Return whether the log of an organisation is whole: no entry changed, missing, added or reordered.

    In `Database.snapshot`: what is added or pruned meanwhile would look like tampering.
    """
    head = one(connection, rows(tenant, audit_heads), AuditHeadRow)
    number = 0 if head is None else head.removed_number
    digest = "" if head is None else head.removed_hash
    num_entries = 0
    for entry in entries(connection, tenant):
        number += 1
        problem = ""
        if entry.number != number or entry.id != entry_id(number):
            problem = f"entry {number} is missing: {entry.id} follows the one before"
        elif entry.hash != (digest := _digest(digest, tenant, asdict(entry))):
            problem = f"entry {entry.id} was changed, or one before it"
        if problem:
            return Verdict(num_entries=num_entries, number=number, hash=digest, problem=problem)
        num_entries += 1
    known = (0, "") if head is None else (head.number, head.hash)
    problem = "" if known == (number, digest) else f"the entries after {entry_id(number)} are missing"
    return Verdict(num_entries=num_entries, number=number, hash=digest, problem=problem)


def entries(connection: Connection, tenant: Tenant) -> Iterator[AuditRow]:
    """Yield the entries of an organisation, oldest first, a thousand at a time from the database."""
    last = ""
    while True:
        some = rows(tenant, audit_entries).where(audit_entries.c.id > last).order_by(audit_entries.c.id)
        batch = many(connection, some.limit(_BATCH), AuditRow)
        if not batch:
            return
        yield from batch
        last = batch[-1].id


def num_before(connection: Connection, tenant: Tenant, before: float) -> int:
    """Return how many of the oldest entries are from before a time: those up to the first that is not."""
    later = rows(tenant, audit_entries, audit_entries.c.number).where(audit_entries.c.at >= before)
    first = connection.execute(later.order_by(audit_entries.c.number).limit(1)).scalar_one_or_none()
    head = one(connection, rows(tenant, audit_heads), AuditHeadRow)
    if head is None:
        return 0
    return int((head.number if first is None else first - 1) - head.removed_number)


def remove_before(connection: Connection, tenant: Tenant, before: float) -> int:
    """Remove the entries from before a time and return their number; the rest can still be verified."""
    # Before they are counted: of two at once, the second would remove as many again.
    head = _lock_head(connection, tenant)
    num_entries = num_before(connection, tenant, before)
    if num_entries == 0:
        return 0
    up_to = head.removed_number + num_entries
    last = rows(tenant, audit_entries, audit_entries.c.hash).where(audit_entries.c.number == up_to)
    digest = connection.execute(last).scalar_one()
    _remove_up_to(connection, tenant, up_to)
    connection.execute(change(tenant, audit_heads).values(removed_number=up_to, removed_hash=digest))
    return num_entries


def remove_all(connection: Connection, tenant: Tenant) -> None:
    """Remove the whole log of an organisation that is deleted."""
    _remove_up_to(connection, tenant, _lock_head(connection, tenant).number)
    connection.execute(remove(tenant, audit_heads))


def _remove_up_to(connection: Connection, tenant: Tenant, number: int) -> None:
    connection.execute(add(tenant, audit_permits, up_to=number))
    connection.execute(remove(tenant, audit_entries).where(audit_entries.c.number <= number))
    connection.execute(remove(tenant, audit_permits))


def contains(connection: Connection, tenant: Tenant, noted: str) -> bool:
    """Return whether an entry noted as "number:hash" is there, or was the newest that retention removed."""
    number, _, digest = noted.partition(":")
    if not number.isdecimal() or not digest:
        return False
    entry = rows(tenant, audit_entries, audit_entries.c.hash).where(audit_entries.c.number == int(number))
    if connection.execute(entry).scalar_one_or_none() == digest:
        return True
    head = one(connection, rows(tenant, audit_heads), AuditHeadRow)
    return head is not None and (head.removed_number, head.removed_hash) == (int(number), digest)


def tenants(connection: Connection) -> list[Tenant]:
    """Return the organisations that have a log, the server's own among them."""
    ids = connection.execute(select(audit_heads.c.tenant_id).order_by(audit_heads.c.tenant_id))
    return [Tenant(tenant_id) for tenant_id in ids.scalars()]
