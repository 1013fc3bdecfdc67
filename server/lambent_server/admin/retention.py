"""`lambent admin retention`: how long organisations keep their things, and what that deletes."""

import json
from typing import Annotated, Any

import typer
from pydantic import JsonValue

from lambent_server.accounts import audit, organisations
from lambent_server.accounts.who import operator
from lambent_server.admin.opened import JsonOption, YesOption, age, opened, print_rows
from lambent_server.cli import DatabaseOption, DataOption
from lambent_server.core.clock import rfc3339
from lambent_server.database.tenancy import Tenant
from lambent_server.maintenance import retention

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    help="How long organisations keep what is not labelled `keep`.",
)
IdArgument = Annotated[str, typer.Argument(metavar="ORG", help="Id of the organisation.")]
_AGE = "such as 90d, or never"
NEVER = "never"


@app.command("set")
def set_rules(
    org: IdArgument,
    scenes: Annotated[str, typer.Option(metavar="AGE", help=f"Delete scenes older than this, {_AGE}.")] = "",
    jobs: Annotated[str, typer.Option(metavar="AGE", help="Jobs, from their end, with their logs.")] = "",
    bundles: Annotated[str, typer.Option(metavar="AGE", help="Bundles, with the links to them.")] = "",
    logs: Annotated[str, typer.Option(metavar="AGE", help="Logs of jobs, from their end.")] = "",
    enforce: Annotated[
        bool | None, typer.Option("--enforce/--no-enforce", help="The server applies the rules every hour.")
    ] = None,
    data: DataOption = None,
    database: DatabaseOption = None,
    as_json: JsonOption = False,
) -> None:
    """Set rules, and show them. Without --enforce, only `retention run --yes` deletes anything."""
    tenant = Tenant(org)
    given = {"scenes": scenes, "jobs": jobs, "bundles": bundles, "logs": logs}
    ages = {kind: None if text == NEVER else age(text) for kind, text in given.items() if text}
    with opened(data, database) as services, services.database.write() as connection:
        row = organisations.require(connection, tenant)
        rules = {**(row.retention or {}), **ages}
        kept: dict[str, Any] = {kind: seconds for kind, seconds in rules.items() if seconds is not None}
        enforced = bool(row.retention_enforced) if enforce is None else enforce
        shown: dict[str, JsonValue] = {"seconds": kept, "enforced": enforced}
        if ages or enforce is not None:
            organisations.update(connection, tenant, retention=kept or None, retention_enforced=int(enforced))
            audit.record(connection, operator(tenant), "retention set", org, details=shown)
    if as_json:
        typer.echo(json.dumps(shown))
        return
    for kind in given:
        typer.echo(f"{kind:<9}{f'{kept[kind] / 86400:g} days' if kind in kept else NEVER}")
    typer.echo(f"{'enforced':<9}{'yes' if enforced else 'no'}")


@app.command()
def run(
    org: IdArgument,
    yes: YesOption = False,
    data: DataOption = None,
    database: DatabaseOption = None,
    as_json: JsonOption = False,
) -> None:
    """Delete what is older than the rules allow, or list it."""
    tenant = Tenant(org)
    with opened(data, database) as services:
        with services.database.read() as connection:
            organisations.require(connection, tenant)
            rules = retention.rules_of(connection, tenant)
        due = retention.due(services, tenant, rules, limit=10_000)
        shown = []
        for each in due:
            done = yes and retention.delete(services, operator(tenant), each)
            row = {"kind": each.kind, "id": each.id, "since": rfc3339(each.since), "deleted": done}
            shown.append(row)
    print_rows(shown, ("kind", "id", "since", "deleted"), as_json)
    if not yes:
        typer.echo(f"{len(shown)} items are due; nothing was changed: add --yes", err=True)
