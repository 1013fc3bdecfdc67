"""Claims of due deliveries, and the outcomes of attempts: each attempt is made by one server only."""

import random
import secrets
from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Any

from sqlalchemy import ColumnElement, Connection, Select, exists, func, or_, select, update

from lambent_server.accounts.makers import maker_of, scopes_of_maker
from lambent_server.accounts.scopes import ADMIN, SUBMIT
from lambent_server.core.clock import JUMP_S, now
from lambent_server.core.settings import Settings
from lambent_server.database.engine import Database
from lambent_server.database.model import DeliveryRow, JobRow, SecretRow, WebhookRow
from lambent_server.database.rows import many, one
from lambent_server.database.service_schema import webhook_deliveries, webhook_secrets
from lambent_server.database.tenancy import Tenant, across_tenants, find, rows
from lambent_server.webhooks.outbox import PENDING
from lambent_server.webhooks.places import Places
from lambent_server.webhooks.rows import FAILED, GONE, disable

DELIVERED = "delivered"
HTTP_GONE = 410
KEPT_ATTEMPTS = 20
_GROWTH = 3.0
_LOOKED_AT = 500
"""Deliveries of one tenant among which those are chosen that its hosts have room for. Hosts that are full
are left out, so the ones behind these are found once the first have filled theirs."""
_LONGEST_DUE = webhook_deliveries.c.next_at


@dataclass(frozen=True, kw_only=True, slots=True)
class Claimed(DeliveryRow):
    """A delivery that one server is making."""

    secrets: tuple[str, ...] = ()
    """What signs it, the newest first; none if nothing may be sent."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Outcome:
    """The result of one attempt."""

    status: int | None = None
    """Of the answer; None if there was none."""
    error: str = ""
    """A code; empty if the receiver accepted the delivery."""
    seconds: float = 0.0
    retry_after_s: float = 0.0
    """How long the receiver asks to be left alone."""


def lease_s(settings: Settings) -> float:
    """Return after how many seconds an attempt whose outcome is unknown counts as lost."""
    return 3 * settings.webhook_timeout_s


def is_due(settings: Settings) -> ColumnElement[bool]:
    """Return the condition that a delivery is due.

    A time that is further away than any wait comes from a clock that has been set back since.
    """
    at, longest_s = now(), max(settings.webhook_give_up_s, lease_s(settings))
    next_at = webhook_deliveries.c.next_at
    return or_(next_at <= at, next_at > at + longest_s + JUMP_S)


def _waiting_tenants(settings: Settings) -> Select[Any]:
    """Return the query of the tenants with due deliveries: one look into the index for each tenant."""
    of = webhook_deliveries.alias().c
    first = select(func.min(of.tenant_id).label("id")).cte("tenants", recursive=True)
    other = webhook_deliveries.alias().c
    later = select(func.min(other.tenant_id)).where(other.tenant_id > first.c.id).scalar_subquery()
    tenants = first.union_all(select(later).where(first.c.id.is_not(None)))
    due = exists().where(webhook_deliveries.c.tenant_id == tenants.c.id, is_due(settings))
    return select(tenants.c.id).where(due)


def claim(database: Database, settings: Settings, places: Places) -> list[Claimed]:
    """Return due deliveries, which belong to the caller until it reports their outcome.

    As many as `places` has room for; each goes to the tenant whose turn it is. The caller takes the places.
    """
    trial, chosen = places.copy(), list[str]()
    with database.read() as connection:
        waiting = {
            tenant_id: _Waiting(settings)
            for tenant_id in connection.execute(_waiting_tenants(settings)).scalars()
        }
        while able := [tenant_id for tenant_id in waiting if trial.has_room(tenant_id)]:
            tenant_id = min(able, key=trial.turn)
            chosen_row = waiting[tenant_id].next(connection, tenant_id, trial)
            if chosen_row is None:
                del waiting[tenant_id]
                continue
            chosen.append(chosen_row.id)
            trial.take(tenant_id, chosen_row.host)
    return _take(database, settings, chosen) if chosen else []


class _Waiting:
    """The due deliveries of one tenant, the longest due first, read when they are needed."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._rows: list[Any] | None = None

    def next(self, connection: Connection, tenant_id: str, places: Places) -> Any:
        """Return the first one whose host has room; None if there is none."""
        if self._rows is None:
            full = places.full_hosts(tenant_id)
            columns = (webhook_deliveries.c.id, webhook_deliveries.c.host)
            due = is_due(self._settings), webhook_deliveries.c.host.not_in(full)
            statement = rows(Tenant(tenant_id), webhook_deliveries, *columns).where(*due)
            self._rows = list(connection.execute(statement.order_by(_LONGEST_DUE).limit(_LOOKED_AT)))
        while self._rows:
            row = self._rows.pop(0)
            if places.may_reach(tenant_id, row.host):
                return row
        return None


def _take(database: Database, settings: Settings, chosen: Collection[str]) -> list[Claimed]:
    """Mark those of the chosen deliveries that are still due and that no other server takes right now."""
    # Chosen without a lock, so each may be taken or settled by now: the condition is repeated with one.
    due = across_tenants(webhook_deliveries).where(webhook_deliveries.c.id.in_(chosen), is_due(settings))
    token = secrets.token_hex(8)
    with database.write() as connection:
        taken = many(connection, due.with_for_update(skip_locked=True), Claimed)
        mine = webhook_deliveries.c.id.in_([row.id for row in taken])
        # The claim is a lease: a server that dies settles nothing, and then the delivery is due again.
        until = now() + lease_s(settings)
        connection.execute(update(webhook_deliveries).where(mine).values(claim=token, next_at=until))
        return [replace(row, claim=token, next_at=until, secrets=_secrets(connection, row)) for row in taken]


def _secrets(connection: Connection, row: DeliveryRow) -> tuple[str, ...]:
    """Return what signs a delivery now: the newest secret first.

    Nothing for one whose subscription was deleted, or whose maker may have nothing sent any more.
    """
    tenant = Tenant(row.tenant_id)
    signer: SecretRow | WebhookRow | None
    asked: JobRow | WebhookRow | None
    if row.webhook_id is None:
        signer = one(connection, rows(tenant, webhook_secrets), SecretRow)
        asked, needed = find(connection, tenant, JobRow, row.job_id or ""), SUBMIT
    else:
        signer = asked = find(connection, tenant, WebhookRow, row.webhook_id)
        needed = ADMIN
    # Of a job that has been deleted, what waits is still sent.
    may = asked is None or needed in scopes_of_maker(connection, tenant, maker_of(asked))
    if signer is None or not may:
        return ()
    if signer.previous_secret is not None and (signer.previous_until or 0.0) > now():
        return signer.secret, signer.previous_secret
    return (signer.secret,)


def release(database: Database, row: DeliveryRow) -> None:
    """Give an attempt back that was broken off, so that the next server makes it at once."""
    with database.write() as connection:
        mine = webhook_deliveries.c.id == row.id, webhook_deliveries.c.claim == row.claim
        connection.execute(update(webhook_deliveries).where(*mine).values(claim=None, next_at=now()))


def settle(database: Database, settings: Settings, row: DeliveryRow, outcome: Outcome) -> str | None:
    """Store the outcome of an attempt and return the new state.

    Returns None if the attempt was no longer the caller's. A receiver that answers 410 gets nothing any more.
    """
    with database.write() as connection:
        statement = across_tenants(webhook_deliveries).where(
            webhook_deliveries.c.id == row.id, webhook_deliveries.c.claim == row.claim
        )
        current = one(connection, statement.with_for_update(), DeliveryRow)
        if current is None:
            return None
        attempt = {
            "at": now(),
            "status": outcome.status,
            "error": outcome.error,
            "seconds": round(outcome.seconds, 3),
        }
        values: dict[str, Any] = {
            "claim": None,
            "num_attempts": current.num_attempts + 1,
            "attempts": [*current.attempts, attempt][-KEPT_ATTEMPTS:],
            **_next(current, outcome, settings),
        }
        if values["next_at"] is None:
            values["ended_at"] = now()
        mine = webhook_deliveries.c.id == row.id
        connection.execute(update(webhook_deliveries).where(mine).values(**values))
        if outcome.status == HTTP_GONE and current.webhook_id is not None:
            disable(connection, Tenant(current.tenant_id), current.webhook_id, GONE)
        return str(values["state"])


def _next(current: DeliveryRow, outcome: Outcome, settings: Settings) -> dict[str, Any]:
    """Return the state after an attempt, and when the next one is due."""
    if not outcome.error:
        return {"state": DELIVERED, "next_at": None}
    due = now() + max(pause_s(current.num_attempts, settings), outcome.retry_after_s)
    if outcome.status == HTTP_GONE or due > current.since + settings.webhook_give_up_s:
        return {"state": FAILED, "next_at": None}
    return {"state": PENDING, "next_at": due}


def pause_s(num_failed_before: int, settings: Settings) -> float:
    """Return the time in seconds until the next attempt: three times as long after each failure.

    A random part keeps the deliveries that failed together from coming back together.
    """
    steps = min(num_failed_before, 64)
    longest = min(settings.webhook_retry_s * _GROWTH**steps, settings.webhook_longest_retry_s)
    return longest * random.uniform(0.75, 1.25)  # noqa: S311 (nothing secret)
