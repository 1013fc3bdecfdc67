"""The outbox: deliveries are stored in the transaction that changes a job, and sent later."""

import json

from sqlalchemy import Connection

from lambent_server.accounts.makers import maker_of, scopes_of_maker
from lambent_server.accounts.scopes import ADMIN, SUBMIT
from lambent_server.core.clock import new_id, now, rfc3339
from lambent_server.database.model import JobRow, SecretRow, WebhookRow
from lambent_server.database.rows import many
from lambent_server.database.service_schema import webhook_deliveries, webhook_secrets, webhooks
from lambent_server.database.tenancy import Tenant, add, add_if_absent, rows
from lambent_server.webhooks.messages import ENDS, PING, DeliveredBody, DeliveredJob
from lambent_server.webhooks.signing import new_signing_secret

PENDING = "pending"
_MESSAGE_CHARACTERS = 1000


def tell(connection: Connection, job: JobRow, state: str, seq: int) -> None:
    """Store a delivery for each subscription to this change, and one for the job's own webhook at its end.

    `job` has the columns after the change, and `seq` is the number of its event.
    """
    tenant, event = Tenant(job.tenant_id), f"job.{state}"
    working = rows(tenant, webhooks).where(webhooks.c.disabled_at.is_(None))
    receivers: list[tuple[str | None, str]] = [
        (row.id, row.url)
        for row in many(connection, working, WebhookRow)
        if event in row.events
        and row.labels.items() <= job.labels.items()
        and ADMIN in scopes_of_maker(connection, tenant, maker_of(row))
    ]
    if job.webhook and event in ENDS and SUBMIT in scopes_of_maker(connection, tenant, maker_of(job)):
        secret_of_jobs(connection, tenant)
        receivers.append((None, job.webhook))
    if not receivers:
        return
    body = DeliveredBody(type=event, timestamp=rfc3339(now()), data=_told(job, state, seq))  # type: ignore[arg-type]
    text = body.model_dump_json()
    for webhook_id, url in receivers:
        store(connection, tenant, webhook_id, job.id, event, url, text)


def _told(job: JobRow, state: str, seq: int) -> DeliveredJob:
    error = job.error
    cut = {"message": error["message"][:_MESSAGE_CHARACTERS], "code": error["code"]} if error else None
    batch_id = job.order_id if job.kind == "batch" else None
    return DeliveredJob.of(job, state=state, seq=seq, batch_id=batch_id, error=cut)


def ping(connection: Connection, tenant: Tenant, webhook: WebhookRow) -> str:
    """Store a delivery that says nothing, and return its id."""
    body = json.dumps({"type": PING, "timestamp": rfc3339(now()), "data": {"webhook_id": webhook.id}})
    return store(connection, tenant, webhook.id, None, PING, webhook.url, body)


def store(
    connection: Connection,
    tenant: Tenant,
    webhook_id: str | None,
    job_id: str | None,
    event: str,
    url: str,
    body: str,
) -> str:
    """Store a delivery that is due now, and return its id."""
    identifier = new_id("msg")
    connection.execute(
        add(
            tenant,
            webhook_deliveries,
            id=identifier,
            webhook_id=webhook_id,
            job_id=job_id,
            event=event,
            url=url,
            host=host_of(url),
            body=body,
            state=PENDING,
            created_at=now(),
            since=now(),
            next_at=now(),
            attempts=[],
        )
    )
    return identifier


def host_of(url: str) -> str:
    """Return what counts as one receiver: the URL up to its path."""
    return "/".join(url.split("?")[0].split("/")[:3]).lower()


def secret_of_jobs(connection: Connection, tenant: Tenant) -> SecretRow:
    """Return the row of the secret that signs what jobs ask for themselves; the first call makes it."""
    add_if_absent(connection, tenant, webhook_secrets, secret=new_signing_secret())
    (row,) = many(connection, rows(tenant, webhook_secrets), SecretRow)
    return row
