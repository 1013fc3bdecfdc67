"""Webhooks: subscriptions to changes of jobs, and what was delivered."""

from typing import Annotated

from fastapi import APIRouter, Query, Request, Response

from lambent_server.accounts import audit
from lambent_server.api.idempotency import made_before
from lambent_server.api.pagination import PageFilter, select_newest
from lambent_server.api.problems import conflict
from lambent_server.api.resources import IdempotencyKey, IfMatch, ResourceRoute, digest_of, require_match
from lambent_server.core.clock import new_id
from lambent_server.database.model import DeliveryRow, WebhookRow
from lambent_server.database.service_schema import webhook_deliveries
from lambent_server.http.common import Id, ServicesOf, TenantOf, WhoOf, problems, require_key
from lambent_server.webhooks import outbox as webhook_outbox
from lambent_server.webhooks import rows as webhook_rows
from lambent_server.webhooks.messages import (
    CreatedWebhook,
    Delivery,
    DeliveryList,
    DeliveryState,
    NewWebhook,
    SigningSecret,
    Webhook,
    WebhookChange,
    WebhookList,
)

router = APIRouter(tags=["webhooks"], route_class=ResourceRoute)
# A subscription outlasts the session of the browser that made it.
_WHAT = "managing webhooks"


class DeliveryFilter(PageFilter):
    """The deliveries to list."""

    webhook: Annotated[str | None, Query(pattern="^[a-z0-9_]{1,64}$")] = None
    job: Annotated[str | None, Query(pattern="^[a-z0-9_]{1,64}$")] = None
    state: DeliveryState | None = None


@router.post("/v1/webhooks", status_code=201, responses=problems(400, 403, 413, 422, 429))
def create_webhook(
    services: ServicesOf,
    tenant: TenantOf,
    who: WhoOf,
    request: Request,
    body: NewWebhook,
    key: IdempotencyKey = None,
) -> CreatedWebhook:
    """Subscribe to changes of jobs; the secret in the answer signs the deliveries."""
    require_key(request, _WHAT)
    identifier = new_id("webhook")
    with services.database.write() as connection:
        known = made_before(connection, tenant, key, digest_of("webhook", body), identifier)
        if known is None:
            row = webhook_rows.create(connection, tenant, body, services.settings, identifier, who.maker)
            audit.record(connection, who, "create_webhook", identifier)
        else:
            row = webhook_rows.require(connection, tenant, known)
        return webhook_rows.show_created(row)


@router.get("/v1/webhooks", responses=problems(422))
def list_webhooks(
    services: ServicesOf, tenant: TenantOf, given: Annotated[PageFilter, Query()]
) -> WebhookList:
    """List subscriptions, newest first."""
    with services.database.read() as connection:
        page, cursor = select_newest(connection, tenant, WebhookRow, page=given)
    return WebhookList(items=[webhook_rows.show(row) for row in page], next_cursor=cursor)


@router.get("/v1/webhooks/{webhook_id:id}", responses=problems(404))
def get_webhook(services: ServicesOf, tenant: TenantOf, webhook_id: Id) -> Webhook:
    """Return a subscription."""
    with services.database.read() as connection:
        return webhook_rows.show(webhook_rows.require(connection, tenant, webhook_id))


@router.patch("/v1/webhooks/{webhook_id:id}", responses=problems(400, 403, 404, 412, 413, 422))
def change_webhook(
    services: ServicesOf,
    tenant: TenantOf,
    who: WhoOf,
    request: Request,
    webhook_id: Id,
    body: WebhookChange,
    if_match: IfMatch = None,
) -> Webhook:
    """Change a subscription; what is not given stays."""
    require_key(request, _WHAT)
    with audit.recorded(services.database, who, "change_webhook", webhook_id) as connection:
        row = webhook_rows.require(connection, tenant, webhook_id, lock=True)
        require_match(if_match, webhook_rows.show(row))
        changed = webhook_rows.update(connection, tenant, row, body, services.settings, who.maker)
        return webhook_rows.show(changed)


@router.delete(
    "/v1/webhooks/{webhook_id:id}", status_code=204, response_class=Response, responses=problems(403, 404)
)
def delete_webhook(services: ServicesOf, tenant: TenantOf, who: WhoOf, webhook_id: Id) -> None:
    """Delete a subscription and the list of its deliveries; what waits is not sent."""
    with audit.recorded(services.database, who, "delete_webhook", webhook_id) as connection:
        webhook_rows.delete(connection, tenant, webhook_id)


@router.post("/v1/webhooks/{webhook_id:id}:rotate", responses=problems(403, 404))
def rotate_webhook(
    services: ServicesOf, tenant: TenantOf, who: WhoOf, request: Request, webhook_id: Id
) -> CreatedWebhook:
    """Replace the secret; for a day deliveries are signed with the old one too."""
    require_key(request, _WHAT)
    with audit.recorded(services.database, who, "rotate_webhook", webhook_id) as connection:
        row = webhook_rows.require(connection, tenant, webhook_id, lock=True)
        fresh = webhook_rows.rotate(connection, tenant, row, services.settings.webhook_rotation_s)
        return webhook_rows.show_created(fresh)


@router.post("/v1/webhooks/{webhook_id:id}:ping", status_code=202, responses=problems(403, 404, 409))
def ping_webhook(services: ServicesOf, tenant: TenantOf, who: WhoOf, webhook_id: Id) -> Delivery:
    """Send a message of type `ping`; the delivery tells how that went."""
    with audit.recorded(services.database, who, "ping_webhook", webhook_id) as connection:
        row = webhook_rows.require(connection, tenant, webhook_id)
        if row.disabled_at is not None:
            raise conflict("webhook_disabled", f"webhook {webhook_id} is disabled; enable it first")
        delivery_id = webhook_outbox.ping(connection, tenant, row)
        return webhook_rows.show_delivery(webhook_rows.require_delivery(connection, tenant, delivery_id))


@router.get("/v1/webhook-secret", responses=problems(403))
def get_webhook_secret(services: ServicesOf, tenant: TenantOf, who: WhoOf, request: Request) -> SigningSecret:
    """Return the secret that signs what jobs with a `webhook` of their own send; the first call makes it."""
    require_key(request, _WHAT)
    with audit.recorded(services.database, who, "get_webhook_secret") as connection:
        secret = webhook_outbox.secret_of_jobs(connection, tenant).secret
        return SigningSecret(secret=secret)


@router.post("/v1/webhook-secret:rotate", responses=problems(403))
def rotate_webhook_secret(
    services: ServicesOf, tenant: TenantOf, who: WhoOf, request: Request
) -> SigningSecret:
    """Replace that secret; for a day deliveries are signed with the old one too."""
    require_key(request, _WHAT)
    overlap_s = services.settings.webhook_rotation_s
    with audit.recorded(services.database, who, "rotate_webhook_secret") as connection:
        secret = webhook_rows.rotate_secret_of_jobs(connection, tenant, overlap_s)
        return SigningSecret(secret=secret)


@router.get("/v1/deliveries", responses=problems(422))
def list_deliveries(
    services: ServicesOf, tenant: TenantOf, given: Annotated[DeliveryFilter, Query()]
) -> DeliveryList:
    """List deliveries, newest first."""
    columns = {"webhook_id": given.webhook, "job_id": given.job, "state": given.state}
    conditions = [webhook_deliveries.c[name] == value for name, value in columns.items() if value is not None]
    with services.database.read() as connection:
        page, cursor = select_newest(connection, tenant, DeliveryRow, *conditions, page=given)
    return DeliveryList(items=[webhook_rows.show_delivery(row) for row in page], next_cursor=cursor)


@router.get("/v1/deliveries/{delivery_id:id}", responses=problems(404))
def get_delivery(services: ServicesOf, tenant: TenantOf, delivery_id: Id) -> Delivery:
    """Return a delivery."""
    with services.database.read() as connection:
        return webhook_rows.show_delivery(webhook_rows.require_delivery(connection, tenant, delivery_id))


@router.post("/v1/deliveries/{delivery_id:id}:redeliver", status_code=202, responses=problems(403, 404, 409))
def redeliver(services: ServicesOf, tenant: TenantOf, who: WhoOf, delivery_id: Id) -> Delivery:
    """Deliver again, with the same id and body; the attempts continue for another day."""
    with audit.recorded(services.database, who, "redeliver", delivery_id) as connection:
        row = webhook_rows.require_delivery(connection, tenant, delivery_id, lock=True)
        again = webhook_rows.redeliver(connection, tenant, row)
        return webhook_rows.show_delivery(again)
