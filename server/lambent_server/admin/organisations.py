"""`lambent admin org` and `lambent admin quota`: organisations, and what each may use."""

import json
import re
import time
from pathlib import Path
from typing import Annotated, Any

import typer
from sqlalchemy import Connection

from lambent_server.accounts import audit, organisations, quotas, usage, users
from lambent_server.accounts.organisations import ID_PATTERN
from lambent_server.accounts.who import operator
from lambent_server.admin.opened import JsonOption, StoreOption, YesOption, opened, print_rows
from lambent_server.cli import DatabaseOption, DataOption
from lambent_server.core.clock import now, rfc3339
from lambent_server.database.model import OrganisationRow
from lambent_server.database.tenancy import DEFAULT_TENANT_ID, Tenant
from lambent_server.jobs.queries import num_unfinished, promised_gpu_minutes
from lambent_server.maintenance import erasure, housekeeping
from lambent_server.services import Services

app = typer.Typer(
    add_completion=False, no_args_is_help=True, help="Organisations, which cannot see each other's data."
)
IdArgument = Annotated[str, typer.Argument(metavar="ORG", help="Id of the organisation.")]


@app.command()
def create(
    org: IdArgument,
    name: Annotated[str, typer.Option(help="Name to show; the id by default.")] = "",
    data: DataOption = None,
    database: DatabaseOption = None,
) -> None:
    """Add an organisation. Its id has lower-case letters, digits, - and _, and never changes."""
    tenant = Tenant(checked_id(org))
    with opened(data, database) as services, services.database.write() as connection:
        organisations.create(connection, tenant, name or org)
        audit.record(connection, operator(tenant), "org create", org)
    typer.echo(f"{org} created; add people with `lambent admin user add`, programs with `admin key create`")


def checked_id(org: str) -> str:
    """Return an id that an organisation can have; raises typer.BadParameter for any other text."""
    if not re.fullmatch(ID_PATTERN, org):
        raise typer.BadParameter(f"{org!r} is not a valid id: 1 to 40 lower-case letters, digits, - and _")
    return org


@app.command("list")
def list_organisations(
    data: DataOption = None, database: DatabaseOption = None, as_json: JsonOption = False
) -> None:
    """List organisations with their members, unfinished jobs and bytes."""
    with opened(data, database) as services, services.database.read() as connection:
        shown = [_show(services, connection, row) for row in organisations.all_of_them(connection)]
    print_rows(shown, ("id", "name", "closed", "members", "unfinished_jobs", "bytes"), as_json)


def _show(services: Services, connection: Connection, row: OrganisationRow) -> dict[str, Any]:
    tenant = Tenant(row.tenant_id)
    return {
        "id": tenant.id,
        "name": row.name,
        "created_at": rfc3339(row.created_at),
        "closed": row.closed_at is not None,
        "members": users.num_members(connection, tenant),
        "unfinished_jobs": num_unfinished(connection, tenant),
        "bytes": int(usage.amount(connection, tenant, usage.BYTES)),
        "retention": row.retention,
        "retention_enforced": bool(row.retention_enforced),
    }


@app.command()
def close(org: IdArgument, data: DataOption = None, database: DatabaseOption = None) -> None:
    """Close an organisation: its keys, sessions and links stop working. Jobs continue, nothing is deleted."""
    _set_closed(org, True, data, database)


@app.command("open")
def reopen(org: IdArgument, data: DataOption = None, database: DatabaseOption = None) -> None:
    """Open a closed organisation again."""
    _set_closed(org, False, data, database)


def _set_closed(org: str, closed: bool, data: Path | None, database: str | None) -> None:
    tenant = Tenant(org)
    with opened(data, database) as services, services.database.write() as connection:
        organisations.update(connection, tenant, closed_at=now() if closed else None)
        audit.record(connection, operator(tenant), "org close" if closed else "org open", org)
    typer.echo(f"{org} {'closed' if closed else 'open'}")


@app.command()
def delete(
    org: IdArgument,
    yes: YesOption = False,
    wait_s: Annotated[
        float,
        typer.Option(
            "--wait",
            metavar="SECONDS",
            help="Wait for runs to end and for the last bytes.",
            min=0,
        ),
    ] = 120.0,
    data: DataOption = None,
    database: DatabaseOption = None,
    store: StoreOption = None,
) -> None:
    """Delete an organisation: rows, files, keys, people who belong to no other, its audit log.

    It is closed first, its jobs are cancelled, and when their runs have ended everything is deleted. Exit
    code 1 if some bytes are left for the server to delete. This cannot be undone.
    """
    tenant = Tenant(org)
    if org == DEFAULT_TENANT_ID:
        raise typer.BadParameter("the server's own key belongs to it; delete its contents instead")
    with opened(data, database, store, with_store=True) as services:
        with services.database.read() as connection:
            organisations.require(connection, tenant)
            counts = erasure.count(connection, tenant)
        for name, num_rows in counts.items():
            typer.echo(f"{name:<24}{num_rows}")
        if not yes:
            typer.echo("nothing was changed: add --yes", err=True)
            return
        deadline = time.monotonic() + wait_s
        while erasure.close(services, operator(tenant)) and time.monotonic() < deadline:
            time.sleep(0.2)
        erasure.erase(services, operator(tenant))
        typer.echo(f"{org} deleted", err=True)
        housekeeping.sweep(services)
        while not erasure.is_erased(services, tenant) and time.monotonic() < deadline:
            time.sleep(0.2)
            housekeeping.sweep(services)
        left = not erasure.is_erased(services, tenant)
    if left:
        typer.echo("some bytes are left; the server deletes them within minutes", err=True)
    raise typer.Exit(int(left))


def quota(
    org: IdArgument,
    max_bytes: Annotated[
        str, typer.Option("--bytes", metavar="N", help="Bytes to store, such as 500G; 0: no limit.")
    ] = "",
    max_jobs: Annotated[
        int | None, typer.Option("--jobs", metavar="N", help="Unfinished jobs.", min=1)
    ] = None,
    max_gpu_minutes: Annotated[
        float | None,
        typer.Option("--gpu-minutes", metavar="N", help="GPU minutes a month; 0: no limit.", min=0),
    ] = None,
    default: Annotated[
        bool, typer.Option("--default", help="Reset to the limits of the settings first.")
    ] = False,
    data: DataOption = None,
    database: DatabaseOption = None,
    as_json: JsonOption = False,
) -> None:
    """Set the quotas of an organisation, and show them with what it uses."""
    tenant = Tenant(org)
    given = {
        "max_bytes": size(max_bytes) if max_bytes else None,
        "max_jobs": max_jobs,
        "max_gpu_minutes": max_gpu_minutes,
    }
    with opened(data, database) as services, services.database.write() as connection:
        row = organisations.require(connection, tenant)
        values = dict.fromkeys(given) if default else {}
        values |= {name: value for name, value in given.items() if value is not None}
        limits = quotas.quotas_of(connection, tenant, services.settings)
        if values:
            organisations.update(connection, tenant, **values)
            limits = quotas.quotas_of(connection, tenant, services.settings)
        minutes = quotas.month_used(connection, tenant) + promised_gpu_minutes(connection, tenant)
        used = {
            "bytes": (usage.amount(connection, tenant, usage.BYTES), limits.bytes),
            "jobs": (num_unfinished(connection, tenant), limits.jobs),
            "gpu_minutes": (round(minutes, 1), limits.gpu_minutes),
        }
        if values:
            changed = {name: [getattr(row, name), value] for name, value in values.items()}
            audit.record(connection, operator(tenant), "quota", org, details=changed)
    if as_json:
        typer.echo(json.dumps({name: {"used": use, "limit": limit} for name, (use, limit) in used.items()}))
        return
    rows = [
        {"quota": name, "used": f"{use:.15g}", "limit": "none" if limit is None else f"{limit:.15g}"}
        for name, (use, limit) in used.items()
    ]
    print_rows(rows, ("quota", "used", "limit"), as_json=False)


def size(text: str) -> float:
    """Return the bytes of a size such as 500G (G: 10^9); raises typer.BadParameter for any other text."""
    factors = {"": 1, "K": 10**3, "M": 10**6, "G": 10**9, "T": 10**12}
    number = text.rstrip("KMGT")
    if not number.isdecimal() or text[len(number) :] not in factors:
        raise typer.BadParameter(f"{text!r} is not a size such as 20000, 500M, 80G or 2T")
    return float(int(number) * factors[text[len(number) :]])
