"""`lambent admin audit`: verify the chain of the log, export it, remove what is old enough."""

import json
from dataclasses import asdict
from typing import Annotated

import typer

from lambent_server.accounts import audit
from lambent_server.accounts.who import operator
from lambent_server.admin.opened import JsonOption, YesOption, age, opened
from lambent_server.cli import DatabaseOption, DataOption
from lambent_server.core.clock import now, rfc3339
from lambent_server.database.tenancy import Tenant

app = typer.Typer(add_completion=False, no_args_is_help=True, help="The audit log of each organisation.")
OrgOption = Annotated[
    str, typer.Option("--org", metavar="ORG", help="Only of this one; `-` for entries of no organisation.")
]


@app.command()
def verify(
    org: OrgOption = "",
    expect: Annotated[
        str,
        typer.Option(
            metavar="NUMBER:HASH", help="An entry noted earlier, which must still exist; needs --org."
        ),
    ] = "",
    data: DataOption = None,
    database: DatabaseOption = None,
    as_json: JsonOption = False,
) -> None:
    """Find changed, removed, added or reordered entries; exit code 1 if there are any.

    Prints number and hash of the newest entry. Noted elsewhere and given as --expect, they also prove that
    the log was not rewritten as a whole.
    """
    if expect and not org:
        raise typer.BadParameter("--expect needs --org")
    failed = False
    with opened(data, database) as services, services.database.snapshot() as connection:
        wanted = [Tenant("" if org == "-" else org)] if org else audit.tenants(connection)
        for tenant in wanted:
            verdict = audit.verify(connection, tenant)
            problem = verdict.problem
            if expect and not problem and not audit.contains(connection, tenant, expect):
                problem = f"there is no entry {expect}: the log was rewritten, or this entry was removed"
            failed |= bool(problem)
            shown = {
                "org": tenant.id or "-",
                "ok": not problem,
                "entries": verdict.num_entries,
                "head": f"{verdict.number}:{verdict.hash}",
                "problem": problem,
            }
            if as_json:
                typer.echo(json.dumps(shown))
            elif problem:
                typer.echo(f"audit.broken: {shown['org']}: {problem}", err=True)
            else:
                typer.echo(f"{shown['org']}: {verdict.num_entries} entries are whole, head {shown['head']}")
    raise typer.Exit(int(failed))


@app.command()
def export(org: OrgOption = "", data: DataOption = None, database: DatabaseOption = None) -> None:
    """Print the log as JSON lines, oldest first."""
    with opened(data, database) as services, services.database.read() as connection:
        wanted = [Tenant("" if org == "-" else org)] if org else audit.tenants(connection)
        for tenant in wanted:
            for row in audit.entries(connection, tenant):
                entry = {**asdict(row), "at": rfc3339(row.at), "details": json.loads(row.details)}
                entry["org"] = entry.pop("tenant_id")
                typer.echo(json.dumps(entry))


@app.command()
def prune(
    org: OrgOption,
    older: Annotated[str, typer.Option("--older-than", metavar="AGE", help="Such as 400d.")],
    yes: YesOption = False,
    data: DataOption = None,
    database: DatabaseOption = None,
) -> None:
    """Remove the oldest entries; the rest can still be verified. Nothing else removes entries."""
    tenant, before = Tenant("" if org == "-" else org), now() - age(older)
    with opened(data, database) as services, services.database.write() as connection:
        if not yes:
            typer.echo(
                f"{audit.num_before(connection, tenant, before)} entries; nothing was changed: add --yes"
            )
            return
        num_entries = audit.remove_before(connection, tenant, before)
        audit.record(connection, operator(tenant), "audit prune", details={"entries": num_entries})
    typer.echo(f"{num_entries} entries removed")
