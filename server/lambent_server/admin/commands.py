"""status, servers, drain, maintenance, reconcile and keys; other groups are modules of their own."""

import json
import time
from dataclasses import asdict
from enum import StrEnum
from typing import Annotated, Any

import typer
from sqlalchemy import func, or_

from lambent_server.accounts import audit
from lambent_server.accounts.who import operator
from lambent_server.admin import organisations, people, retention, webhooks
from lambent_server.admin.audit import app as audit_app
from lambent_server.admin.jobs import jobs
from lambent_server.admin.opened import JsonOption, StoreOption, opened, print_rows
from lambent_server.cli import DatabaseOption, DataOption, keys
from lambent_server.cluster.membership import members
from lambent_server.cluster.server_state import DRAIN, MAINTENANCE, announce, read, withdraw
from lambent_server.core.clock import rfc3339
from lambent_server.core.settings import ServeError
from lambent_server.database.schema import jobs as job_table
from lambent_server.database.service_schema import webhook_deliveries
from lambent_server.database.tenancy import across_tenants
from lambent_server.jobs.rows import FINAL, HAS_RUN
from lambent_server.services import Services
from lambent_server.storage.decoding import probe

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    help="Operate the server of this machine, in its database: it may be running or not.",
)
app.command()(jobs)
app.add_typer(webhooks.app, name="webhooks")
app.add_typer(organisations.app, name="org")
app.add_typer(people.app, name="user")
app.add_typer(people.keys_app, name="key")
app.add_typer(audit_app, name="audit")
app.add_typer(retention.app, name="retention")
app.command("quota")(organisations.quota)
app.command("keys")(keys)


class Switch(StrEnum):
    """On or off."""

    ON = "on"
    OFF = "off"


def _state(services: Services) -> dict[str, Any]:

    active = job_table.c.state.not_in(FINAL)
    has_process = or_(job_table.c.state.in_(HAS_RUN), job_table.c.handle.is_not(None))
    waiting = webhook_deliveries.c.next_at.is_not(None)
    with services.database.read() as connection:
        notices = read(connection)
        by_state = across_tenants(job_table, job_table.c.state, func.count()).where(active)
        grouped = connection.execute(by_state.group_by(job_table.c.state))
        counts = {row[0]: row[1] for row in grouped}
        running = across_tenants(job_table, func.count()).where(has_process)
        processes = connection.execute(running).scalar_one()
        unsent = connection.execute(across_tenants(webhook_deliveries, func.count()).where(waiting))
        num_waiting = unsent.scalar_one()
    told = {
        name: {"since": rfc3339(notices[name].since), "message": notices[name].message}
        if name in notices
        else None
        for name in (DRAIN, MAINTENANCE)
    }
    return {**told, "jobs": counts, "processes": processes, "webhooks_waiting": num_waiting}


def _sandbox(services: Services) -> dict[str, Any]:
    """Return the layers around processes that decode uploads on this machine, and what is missing."""
    layers = probe(services.settings)
    return {"wanted": services.settings.sandbox, "in_force": layers.in_force, "missing": layers.missing}


@app.command()
def status(data: DataOption = None, database: DatabaseOption = None, as_json: JsonOption = False) -> None:
    """Show drain and maintenance, unfinished jobs, waiting webhooks, and how uploads are decoded."""
    with opened(data, database) as services:
        shown = {**_state(services), "sandbox": _sandbox(services)}
    if as_json:
        typer.echo(json.dumps(shown))
        return
    for name in ("drain", "maintenance"):
        notice = shown[name]
        text = f"on since {notice['since']} {notice['message']}".rstrip() if notice else "off"
        typer.echo(f"{name:<18}{text}")
    jobs_text = ", ".join(f"{count} {state}" for state, count in sorted(shown["jobs"].items())) or "none"
    typer.echo(f"{'unfinished jobs':<18}{jobs_text}")
    typer.echo(f"{'processes':<18}{shown['processes']}")
    typer.echo(f"{'webhooks waiting':<18}{shown['webhooks_waiting']}")
    typer.echo(f"{'sandbox':<18}{', '.join(shown['sandbox']['in_force'])}")
    for name, reason in shown["sandbox"]["missing"].items():
        typer.echo(f"{'':<18}without {name}: {reason}")


@app.command()
def servers(data: DataOption = None, database: DatabaseOption = None, as_json: JsonOption = False) -> None:
    """List the servers on this database, those that died lately among them, and which one leads."""
    with opened(data, database) as services, services.database.read() as connection:
        known = members(connection)
    rows = []
    for each in known:
        times = {name: rfc3339(getattr(each, name)) for name in ("started_at", "beat_at")}
        silent = f"silent since {times['beat_at']}"
        state = "leads" if each.leads else "alive" if each.is_alive else silent
        rows.append({**asdict(each), **times, "state": state})
    print_rows(rows, ("id", "state", "hostname", "url", "slots", "gpus", "version", "endpoints"), as_json)


@app.command()
def drain(
    switch: Annotated[Switch, typer.Argument(help="on, or off again.")] = Switch.ON,
    message: Annotated[str, typer.Option(help="The reason, shown to users.")] = "",
    wait: Annotated[bool, typer.Option("--wait", help="Return when no run is left.")] = False,
    data: DataOption = None,
    database: DatabaseOption = None,
) -> None:
    """Start no more runs: running ones finish, and new jobs are accepted and wait in the queue."""
    with opened(data, database) as services:
        _tell(services, DRAIN, switch, message)
        while wait and switch is Switch.ON and _state(services)["processes"]:
            time.sleep(services.settings.tick_s)


@app.command()
def maintenance(
    switch: Annotated[Switch, typer.Argument(help="on, or off again.")],
    message: Annotated[str, typer.Option(help="Text of the response to changes that are refused.")] = "",
    retry_after_s: Annotated[
        int, typer.Option("--retry-after", help="Seconds after which they may try again.", min=1, max=86400)
    ] = 60,
    data: DataOption = None,
    database: DatabaseOption = None,
) -> None:
    """Refuse changes with 503 and Retry-After; reading still works, and runs continue and report."""
    with opened(data, database) as services:
        _tell(services, MAINTENANCE, switch, message, retry_after_s)


def _tell(services: Services, name: str, switch: Switch, message: str, retry_after_s: int = 60) -> None:
    with services.database.write() as connection:
        if switch is Switch.ON:
            announce(connection, name, message, retry_after_s)
        else:
            withdraw(connection, name)
        told = {"switch": str(switch), "message": message}
        audit.record(connection, operator(audit.SERVER), name, details=told)
    typer.echo(f"{name} {switch}; every server on this database follows within a second")


@app.command()
def reconcile(data: DataOption = None, database: DatabaseOption = None, store: StoreOption = None) -> None:
    """Compare database and store now, and remove what no row names; stop the server first.

    A running server does the same at its start and every hour. Exit code 1 when bytes are missing.
    """
    # Slow to import: the whole server.
    from lambent_server.running import reconciler
    from lambent_server.serving import sole_user

    with opened(data, database, store, with_store=True) as services:
        try:
            with sole_user(services.settings.data):
                num_missing = reconciler.reconcile(services)
            with services.database.write() as connection:
                missing = {"missing": num_missing}
                audit.record(connection, operator(audit.SERVER), "reconcile", details=missing)
        except ServeError as error:
            typer.echo(str(error), err=True)
            raise typer.Exit(2) from error
    typer.echo(f"{num_missing} blobs are missing")
    raise typer.Exit(bool(num_missing))
