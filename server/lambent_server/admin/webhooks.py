"""`lambent admin webhooks`: subscriptions of all tenants, and deliveries that wait or failed."""

import json
from typing import Annotated, Any

import typer

from lambent_server.admin.opened import JsonOption, age, columns, opened
from lambent_server.cli import DatabaseOption, DataOption

app = typer.Typer(
    add_completion=False, no_args_is_help=True, help="Webhooks of all tenants, and their deliveries."
)
TenantOption = Annotated[str, typer.Option(help="Only of this tenant.")]
IdArgument = Annotated[str, typer.Argument(metavar="WEBHOOK", help="Id of a subscription.")]


def _print(rows: list[dict[str, Any]], names: tuple[str, ...], as_json: bool) -> None:
    if as_json:
        for row in rows:
            typer.echo(json.dumps(row))
        return
    texts = [tuple("" if row[name] is None else str(row[name]) for name in names) for row in rows]
    columns([tuple(name.upper() for name in names), *texts])


@app.command("list")
def list_webhooks(
    tenant: TenantOption = "",
    data: DataOption = None,
    database: DatabaseOption = None,
    as_json: JsonOption = False,
) -> None:
    """List subscriptions; of URLs only the host is shown, for the rest may be a secret."""
    from lambent_server.database.service_schema import webhooks
    from lambent_server.database.tenancy import across_tenants
    from lambent_server.webhooks.outbox import host_of
    from lambent_server.webhooks.rows import show

    statement = across_tenants(webhooks).order_by(webhooks.c.id)
    if tenant:
        statement = statement.where(webhooks.c.tenant_id == tenant)
    with opened(data, database) as services, services.database.read() as connection:
        rows = [
            {"tenant": row["tenant_id"], **show(row).model_dump(), "url": host_of(row["url"])}
            for row in connection.execute(statement).mappings()
        ]
    _print(rows, ("id", "tenant", "enabled", "disabled_reason", "url", "created_at"), as_json)


@app.command()
def disable(webhook: IdArgument, data: DataOption = None, database: DatabaseOption = None) -> None:
    """Send nothing more to a subscription; what waits has failed."""
    from lambent_server.accounts import audit
    from lambent_server.accounts.who import operator
    from lambent_server.database.tenancy import Tenant
    from lambent_server.webhooks.rows import ASKED
    from lambent_server.webhooks.rows import disable as disable_row

    with opened(data, database) as services, services.database.write() as connection:
        row = _require(connection, webhook)
        tenant = Tenant(row["tenant_id"])
        disable_row(connection, tenant, webhook, ASKED)
        audit.record(connection, operator(tenant), "webhooks disable", webhook)
    typer.echo(f"{webhook} disabled")


@app.command()
def enable(webhook: IdArgument, data: DataOption = None, database: DatabaseOption = None) -> None:
    """Send to a subscription again."""
    from lambent_server.accounts import audit
    from lambent_server.accounts.who import operator
    from lambent_server.database.tenancy import Tenant
    from lambent_server.webhooks.messages import WebhookChange
    from lambent_server.webhooks.rows import update

    with opened(data, database) as services, services.database.write() as connection:
        row = _require(connection, webhook)
        tenant = Tenant(row["tenant_id"])
        update(connection, tenant, row, WebhookChange(enabled=True), services.settings)
        audit.record(connection, operator(tenant), "webhooks enable", webhook)
    typer.echo(f"{webhook} enabled")


def _require(connection: Any, webhook: str) -> dict[str, Any]:
    from lambent_server.api.problems import not_found
    from lambent_server.database.service_schema import webhooks
    from lambent_server.database.tenancy import across_tenants

    found = connection.execute(across_tenants(webhooks).where(webhooks.c.id == webhook)).mappings()
    row = found.one_or_none()
    if row is None:
        raise not_found("webhook", webhook)
    return dict(row)


def _deliveries(services: Any, tenant: str, state: str, older: str) -> list[dict[str, Any]]:
    from lambent_server.core.clock import now
    from lambent_server.database.service_schema import webhook_deliveries
    from lambent_server.database.tenancy import across_tenants

    statement = across_tenants(webhook_deliveries).order_by(webhook_deliveries.c.id.desc()).limit(1000)
    if tenant:
        statement = statement.where(webhook_deliveries.c.tenant_id == tenant)
    if state:
        statement = statement.where(webhook_deliveries.c.state == state)
    if older:
        statement = statement.where(webhook_deliveries.c.created_at < now() - age(older))
    with services.database.read() as connection:
        return [dict(row) for row in connection.execute(statement).mappings()]


StateOption = Annotated[str, typer.Option(help="Only in this state: pending, delivered, failed.")]
OlderOption = Annotated[str, typer.Option("--older-than", metavar="AGE", help="Only older: 30m, 12h, 7d.")]


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
    from lambent_server.webhooks.rows import show_delivery

    with opened(data, database) as services:
        found = _deliveries(services, tenant, state, older)
    rows = []
    for row in found:
        shown = show_delivery(row)
        last = shown.attempts[-1].error if shown.attempts else ""
        rows.append(
            {"tenant": row["tenant_id"], **shown.model_dump(), "url": row["host"], "last_error": last}
        )
    names = ("id", "tenant", "event", "state", "num_attempts", "last_error", "next_at", "url")
    _print(rows, names, as_json)


@app.command()
def redeliver(
    state: StateOption = "failed",
    tenant: TenantOption = "",
    older: OlderOption = "",
    data: DataOption = None,
    database: DatabaseOption = None,
) -> None:
    """Deliver again what failed; receivers know repeats by the id."""
    from lambent_server.accounts import audit
    from lambent_server.accounts.who import operator
    from lambent_server.api.problems import Problem
    from lambent_server.database.tenancy import Tenant
    from lambent_server.webhooks.rows import redeliver as redeliver_row
    from lambent_server.webhooks.rows import require_delivery

    with opened(data, database) as services:
        for row in _deliveries(services, tenant, state, older):
            owner = Tenant(row["tenant_id"])
            try:
                with services.database.write() as connection:
                    current = require_delivery(connection, owner, row["id"], lock=True)
                    redeliver_row(connection, owner, current)
                    audit.record(connection, operator(owner), "webhooks redeliver", row["id"])
            except Problem as problem:
                typer.echo(f"{row['id']}: {problem.code}: {problem.detail}", err=True)
                continue
            typer.echo(row["id"])
