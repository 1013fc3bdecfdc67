"""Database rows of webhooks and their deliveries, as the REST interface reads and changes them."""

from typing import Any

from sqlalchemy import Connection, func

from lambent_server.accounts.makers import columns_of
from lambent_server.accounts.who import NOBODY, Maker
from lambent_server.api import labels as label_rows
from lambent_server.api import resources
from lambent_server.api.idempotency import forget
from lambent_server.api.problems import Problem, conflict, invalid
from lambent_server.core.clock import new_id, now, rfc3339
from lambent_server.core.settings import Settings
from lambent_server.database.model import DeliveryRow, SecretRow, WebhookRow
from lambent_server.database.service_schema import webhook_deliveries, webhook_secrets, webhooks
from lambent_server.database.tenancy import Tenant, add, change, remove, rows
from lambent_server.webhooks.guard import Guard, RefusedAddress
from lambent_server.webhooks.messages import (
    CreatedWebhook,
    Delivery,
    DeliveryAttempt,
    NewWebhook,
    Webhook,
    WebhookChange,
)
from lambent_server.webhooks.outbox import PENDING, host_of, secret_of_jobs
from lambent_server.webhooks.signing import new_signing_secret

FAILED = "failed"
GONE, ASKED = "gone", "asked"


def check_url(url: str, settings: Settings, pointer: str) -> None:
    """Refuse a URL to which this server never sends; names are looked up at every attempt only."""
    try:
        Guard.of(settings).parse(url)
    except RefusedAddress as refused:
        raise invalid(f"webhook_{refused.code}", pointer, str(refused)) from refused


def show(row: WebhookRow) -> Webhook:
    """Return a subscription in the form of the REST interface."""
    return Webhook.of(row, enabled=row.disabled_at is None)


def show_created(row: WebhookRow) -> CreatedWebhook:
    """Return a subscription with its secret."""
    return CreatedWebhook(**show(row).model_dump(), secret=row.secret)


def show_delivery(row: DeliveryRow) -> Delivery:
    """Return a delivery in the form of the REST interface."""
    attempts = [DeliveryAttempt(**{**each, "at": rfc3339(each["at"])}) for each in row.attempts]
    return Delivery.of(row, attempts=attempts)


def require(connection: Connection, tenant: Tenant, webhook_id: str, *, lock: bool = False) -> WebhookRow:
    """Return a subscription's row."""
    return resources.require(connection, tenant, WebhookRow, "webhook", webhook_id, lock=lock)


def require_delivery(
    connection: Connection, tenant: Tenant, delivery_id: str, *, lock: bool = False
) -> DeliveryRow:
    """Return a delivery's row."""
    return resources.require(connection, tenant, DeliveryRow, "delivery", delivery_id, lock=lock)


def create(
    connection: Connection,
    tenant: Tenant,
    order: NewWebhook,
    settings: Settings,
    webhook_id: str | None = None,
    maker: Maker = NOBODY,
) -> WebhookRow:
    """Add a subscription, which ends with its maker."""
    check_url(order.url, settings, "#/url")
    in_use = connection.execute(rows(tenant, webhooks, func.count())).scalar_one()
    if in_use >= settings.max_webhooks:
        raise Problem(
            429,
            "quota_webhooks",
            f"there are {in_use} webhooks, {settings.max_webhooks} are allowed; delete some",
            members={"quota": {"name": "max_webhooks", "limit": settings.max_webhooks, "used": in_use}},
        )
    identifier = webhook_id or new_id("webhook")
    values = order.model_dump()
    common = {"secret": new_signing_secret(), "created_at": now(), "disabled_reason": "", **columns_of(maker)}
    connection.execute(add(tenant, webhooks, id=identifier, **values, **common))
    return require(connection, tenant, identifier)


def update(
    connection: Connection,
    tenant: Tenant,
    row: WebhookRow,
    order: WebhookChange,
    settings: Settings,
    maker: Maker = NOBODY,
) -> WebhookRow:
    """Change a subscription; what waits to be delivered goes to the new address.

    Whoever gives it another address, or enables it, is its maker from then on: it ends with them.
    """
    values = order.model_dump(exclude_none=True, exclude={"enabled", "labels"})
    if order.labels is not None:
        values["labels"] = label_rows.merged(row.labels, order.labels)
    if order.url is not None:
        check_url(order.url, settings, "#/url")
        waiting = webhook_deliveries.c.next_at.is_not(None)
        statement = change(tenant, webhook_deliveries).where(
            webhook_deliveries.c.webhook_id == row.id, waiting
        )
        connection.execute(statement.values(url=order.url, host=host_of(order.url)))
    if order.url is not None or order.enabled is True:
        values |= columns_of(maker)
    if order.enabled is True:
        values |= {"disabled_at": None, "disabled_reason": ""}
    if values:
        connection.execute(change(tenant, webhooks).where(webhooks.c.id == row.id).values(**values))
    if order.enabled is False:
        disable(connection, tenant, row.id, ASKED)
    return require(connection, tenant, row.id)


def disable(connection: Connection, tenant: Tenant, webhook_id: str, reason: str) -> None:
    """Send nothing more to a subscription; what waits to be delivered has failed."""
    mine = webhooks.c.id == webhook_id, webhooks.c.disabled_at.is_(None)
    connection.execute(
        change(tenant, webhooks).where(*mine).values(disabled_at=now(), disabled_reason=reason)
    )
    waiting = webhook_deliveries.c.webhook_id == webhook_id, webhook_deliveries.c.next_at.is_not(None)
    ended = {"state": FAILED, "next_at": None, "claim": None, "ended_at": now()}
    connection.execute(change(tenant, webhook_deliveries).where(*waiting).values(**ended))


def delete(connection: Connection, tenant: Tenant, webhook_id: str) -> None:
    """Delete a subscription with its deliveries; what waits is not sent."""
    require(connection, tenant, webhook_id, lock=True)
    connection.execute(
        remove(tenant, webhook_deliveries).where(webhook_deliveries.c.webhook_id == webhook_id)
    )
    forget(connection, tenant, webhook_id)
    connection.execute(remove(tenant, webhooks).where(webhooks.c.id == webhook_id))


def _rotation(row: WebhookRow | SecretRow, overlap_s: float) -> dict[str, Any]:
    return {
        "secret": new_signing_secret(),
        "previous_secret": row.secret,
        "previous_until": now() + overlap_s,
    }


def rotate(connection: Connection, tenant: Tenant, row: WebhookRow, overlap_s: float) -> WebhookRow:
    """Replace the secret of a subscription; the old one signs too for `overlap_s`."""
    statement = change(tenant, webhooks).where(webhooks.c.id == row.id)
    connection.execute(statement.values(**_rotation(row, overlap_s)))
    return require(connection, tenant, row.id)


def rotate_secret_of_jobs(connection: Connection, tenant: Tenant, overlap_s: float) -> str:
    """Replace the secret that signs what jobs ask for, and return the new one."""
    values = _rotation(secret_of_jobs(connection, tenant), overlap_s)
    connection.execute(change(tenant, webhook_secrets).values(**values))
    return str(values["secret"])


def redeliver(connection: Connection, tenant: Tenant, row: DeliveryRow) -> DeliveryRow:
    """Deliver again, with the same id and body; one that waits is due at once."""
    if row.webhook_id is not None and require(connection, tenant, row.webhook_id).disabled_at is not None:
        raise conflict("webhook_disabled", f"webhook {row.webhook_id} is disabled; enable it first")
    if row.claim is None:
        values = {"state": PENDING, "since": now(), "next_at": now(), "ended_at": None}
        statement = change(tenant, webhook_deliveries).where(webhook_deliveries.c.id == row.id)
        connection.execute(statement.values(**values))
    return require_delivery(connection, tenant, row.id)


def forget_job(connection: Connection, tenant: Tenant, job_id: str) -> None:
    """Delete the ended deliveries of a deleted job; the others are sent first."""
    ended = webhook_deliveries.c.job_id == job_id, webhook_deliveries.c.next_at.is_(None)
    connection.execute(remove(tenant, webhook_deliveries).where(*ended))
