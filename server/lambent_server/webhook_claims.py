"""Claims of due deliveries, and the outcomes of attempts: each attempt is made by one server only."""

import random
import secrets
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Connection, func, select, update

from lambent_server.accounts.makers import maker_of, scopes_of_maker
from lambent_server.accounts.scopes import ADMIN, SUBMIT
from lambent_server.clock import now
from lambent_server.database.engine import Database
from lambent_server.database.schema import jobs
from lambent_server.database.service_schema import webhook_deliveries, webhook_secrets, webhooks
from lambent_server.database.tenancy import Tenant, across_tenants, find, rows
from lambent_server.settings import Settings
from lambent_server.webhook_outbox import PENDING
from lambent_server.webhook_rows import FAILED, GONE, disable

DELIVERED = "delivered"
HTTP_GONE = 410
KEPT_ATTEMPTS = 20
_GROWTH = 3.0
Row = Mapping[str, Any]


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


def claim(database: Database, settings: Settings, room: int, busy: Mapping[str, int]) -> list[dict[str, Any]]:
    """Return up to `room` due deliveries, which belong to the caller until it reports their outcome.

    `busy` says how many attempts are under way at each host; no host gets more than `webhook_per_host`.
    """
    full = [host for host, count in busy.items() if count >= settings.webhook_per_host]
    place = func.row_number().over(
        partition_by=webhook_deliveries.c.host, order_by=webhook_deliveries.c.next_at
    )
    due = (
        across_tenants(
            webhook_deliveries, webhook_deliveries.c.id, webhook_deliveries.c.host, place.label("place")
        )
        .where(webhook_deliveries.c.next_at <= now(), webhook_deliveries.c.host.not_in(full))
        .subquery()
    )
    first = select(due.c.id, due.c.host).where(due.c.place <= settings.webhook_per_host)
    with database.read() as connection:
        found = connection.execute(first.order_by(due.c.place).limit(2 * settings.webhook_concurrency)).all()
    chosen, load = [], dict(busy)
    for identifier, host in found:
        if load.get(host, 0) < settings.webhook_per_host and len(chosen) < room:
            load[host] = load.get(host, 0) + 1
            chosen.append(identifier)
    return _take(database, settings, chosen) if chosen else []


def _take(database: Database, settings: Settings, chosen: Collection[str]) -> list[dict[str, Any]]:
    """Mark those of the chosen deliveries that are still due and that no other server takes right now."""
    due = across_tenants(webhook_deliveries).where(
        webhook_deliveries.c.id.in_(chosen), webhook_deliveries.c.next_at <= now()
    )
    token = secrets.token_hex(8)
    with database.write() as connection:
        taken = connection.execute(due.with_for_update(skip_locked=True)).mappings().all()
        mine = webhook_deliveries.c.id.in_([row["id"] for row in taken])
        values = {"claim": token, "next_at": now() + lease_s(settings)}
        connection.execute(update(webhook_deliveries).where(mine).values(**values))
        return [{**row, **values, "secrets": _secrets(connection, row)} for row in taken]


def _secrets(connection: Connection, row: Row) -> list[str]:
    """Return what signs a delivery now: the newest secret first.

    Nothing for one whose subscription was deleted, or whose maker may have nothing sent any more.
    """
    tenant = Tenant(row["tenant_id"])
    found: Any
    if row["webhook_id"] is None:
        found = connection.execute(rows(tenant, webhook_secrets)).mappings().one_or_none()
        asked, needed = find(connection, tenant, jobs, row["job_id"]), SUBMIT
    else:
        found = asked = find(connection, tenant, webhooks, row["webhook_id"])
        needed = ADMIN
    # Of a job that has been deleted, what waits is still sent.
    may = asked is None or needed in scopes_of_maker(connection, tenant, maker_of(asked))
    if found is None or not may:
        return []
    overlaps = found["previous_secret"] is not None and (found["previous_until"] or 0.0) > now()
    return [found["secret"], *([found["previous_secret"]] if overlaps else [])]


def release(database: Database, row: Row) -> None:
    """Give an attempt back that was broken off, so that the next server makes it at once."""
    with database.write() as connection:
        mine = webhook_deliveries.c.id == row["id"], webhook_deliveries.c.claim == row["claim"]
        connection.execute(update(webhook_deliveries).where(*mine).values(claim=None, next_at=now()))


def settle(database: Database, settings: Settings, row: Row, outcome: Outcome) -> str | None:
    """Store the outcome of an attempt and return the new state.

    Returns None if the attempt was no longer the caller's. A receiver that answers 410 gets nothing any more.
    """
    with database.write() as connection:
        statement = across_tenants(webhook_deliveries).where(
            webhook_deliveries.c.id == row["id"], webhook_deliveries.c.claim == row["claim"]
        )
        current = connection.execute(statement.with_for_update()).mappings().one_or_none()
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
            "num_attempts": current["num_attempts"] + 1,
            "attempts": [*current["attempts"], attempt][-KEPT_ATTEMPTS:],
            **_next(current, outcome, settings),
        }
        if values["next_at"] is None:
            values["ended_at"] = now()
        mine = webhook_deliveries.c.id == row["id"]
        connection.execute(update(webhook_deliveries).where(mine).values(**values))
        if outcome.status == HTTP_GONE and current["webhook_id"] is not None:
            disable(connection, Tenant(current["tenant_id"]), current["webhook_id"], GONE)
        return str(values["state"])


def _next(current: Row, outcome: Outcome, settings: Settings) -> dict[str, Any]:
    """Return the state after an attempt, and when the next one is due."""
    if not outcome.error:
        return {"state": DELIVERED, "next_at": None}
    due = now() + max(pause_s(current["num_attempts"], settings), outcome.retry_after_s)
    if outcome.status == HTTP_GONE or due > current["since"] + settings.webhook_give_up_s:
        return {"state": FAILED, "next_at": None}
    return {"state": PENDING, "next_at": due}


def pause_s(num_failed_before: int, settings: Settings) -> float:
    """Return the time in seconds until the next attempt: three times as long after each failure.

    A random part keeps the deliveries that failed together from coming back together.
    """
    steps = min(num_failed_before, 64)
    longest = min(settings.webhook_retry_s * _GROWTH**steps, settings.webhook_longest_retry_s)
    return longest * random.uniform(0.75, 1.25)  # noqa: S311 (nothing secret)
