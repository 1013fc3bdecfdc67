"""`lambent admin webhooks`: subscriptions of all tenants, and deliveries that wait or failed."""

from typing import Annotated

import typer
from sqlalchemy import Connection

from lambent_server.accounts import audit
from lambent_server.accounts.who import operator
from lambent_server.admin.opened import JsonOption, OlderOption, TenantOption, age, opened, print_rows
from lambent_server.api.problems import Problem, not_found
from lambent_server.cli import DatabaseOption, DataOption
from lambent_server.core.clock import now
from lambent_server.database.model import DeliveryRow, WebhookRow
from lambent_server.database.rows import many, one
from lambent_server.database.service_schema import webhook_deliveries, webhooks
from lambent_server.database.tenancy import Tenant, across_tenants
from lambent_server.services import Services
from lambent_server.webhooks import rows as webhook_rows
from lambent_server.webhooks.messages import WebhookChange
from lambent_server.webhooks.outbox import host_of

app = typer.Typer(
    add_completion=False, no_args_is_help=True, help="Webhooks of all tenants, and their deliveries."
)
IdArgument = Annotated[str, typer.Argument(metavar="WEBHOOK", help="Id of a subscription.")]
StateOption = Annotated[str, typer.Option(help="Only in this state: pending, delivered, failed.")]


@app.command("list")
def list_webhooks(
    tenant: TenantOption = "",
    data: DataOption = None,
    database: DatabaseOption = None,
    as_json: JsonOption = False,
) -> None:
    """List subscriptions; of URLs only the host is shown, because the rest may be a secret."""
    statement = across_tenants(webhooks).order_by(webhooks.c.id)
    if tenant:
        statement = statement.where(webhooks.c.tenant_id == tenant)
    with opened(data, database) as services, services.database.read() as connection:
        rows = [
            {"tenant": row.tenant_id, **webhook_rows.show(row).model_dump(), "url": host_of(row.url)}
            for row in many(connection, statement, WebhookRow)
        ]
    print_rows(rows, ("id", "tenant", "enabled", "disabled_reason", "url", "created_at"), as_json)


@app.command()
def disable(webhook: IdArgument, data: DataOption = None, database: DatabaseOption = None) -> None:
    """Disable a subscription; deliveries that wait fail."""
    with opened(data, database) as services, services.database.write() as connection:
        row = _require(connection, webhook)
        tenant = Tenant(row.tenant_id)
        webhook_rows.disable(connection, tenant, webhook, webhook_rows.ASKED)
        audit.record(connection, operator(tenant), "webhooks disable", webhook)
    typer.echo(f"{webhook} disabled")


@app.command()
def enable(webhook: IdArgument, data: DataOption = None, database: DatabaseOption = None) -> None:
    """Enable a subscription again."""
    with opened(data, database) as services, services.database.write() as connection:
        row = _require(connection, webhook)
        tenant = Tenant(row.tenant_id)
        webhook_rows.update(connection, tenant, row, WebhookChange(enabled=True), services.settings)
        audit.record(connection, operator(tenant), "webhooks enable", webhook)
    typer.echo(f"{webhook} enabled")


def _require(connection: Connection, webhook: str) -> WebhookRow:
    row = one(connection, across_tenants(webhooks).where(webhooks.c.id == webhook), WebhookRow)
    if row is None:
        raise not_found("webhook", webhook)
    return row


def _deliveries(services: Services, tenant: str, state: str, older: str) -> list[DeliveryRow]:
    statement = across_tenants(webhook_deliveries).order_by(webhook_deliveries.c.id.desc()).limit(1000)
    if tenant:
        statement = statement.where(webhook_deliveries.c.tenant_id == tenant)
    if state:
        statement = statement.where(webhook_deliveries.c.state == state)
    if older:
        statement = statement.where(webhook_deliveries.c.created_at < now() - age(older))
    with services.database.read() as connection:
        return many(connection, statement, DeliveryRow)


@app.command()
def deliveries(
    state: StateOption = "",
    tenant: TenantOption = "",
    older: OlderOption = "",
    data: DataOption = None,
    database: DatabaseOption = None,
    as_json: JsonOption = False,
) -> None:
    """List the newest 1000 deliveries."""
    with opened(data, database) as services:
        listed = _deliveries(services, tenant, state, older)
    rows = []
    for row in listed:
        shown = webhook_rows.show_delivery(row)
        last = shown.attempts[-1].error if shown.attempts else ""
        rows.append({"tenant": row.tenant_id, **shown.model_dump(), "url": row.host, "last_error": last})
    names = ("id", "tenant", "event", "state", "num_attempts", "last_error", "next_at", "url")
    print_rows(rows, names, as_json)


@app.command()
def redeliver(
    state: StateOption = "failed",
    tenant: TenantOption = "",
    older: OlderOption = "",
    data: DataOption = None,
    database: DatabaseOption = None,
) -> None:
    """Deliver failed ones again; receivers recognise repeats by their id."""
    with opened(data, database) as services:
        for row in _deliveries(services, tenant, state, older):
            owner = Tenant(row.tenant_id)
            try:
                with services.database.write() as connection:
                    current = webhook_rows.require_delivery(connection, owner, row.id, lock=True)
                    webhook_rows.redeliver(connection, owner, current)
                    audit.record(connection, operator(owner), "webhooks redeliver", row.id)
            except Problem as problem:
                typer.echo(f"{row.id}: {problem.code}: {problem.detail}", err=True)
                continue
            typer.echo(row.id)
