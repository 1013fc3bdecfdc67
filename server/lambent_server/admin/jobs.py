"""`lambent admin jobs`: list, cancel or requeue jobs of all tenants by filter."""

import json
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lambent_server.admin.opened import JsonOption, age, columns, opened
from lambent_server.cli import DatabaseOption, DataOption

if TYPE_CHECKING:
    from sqlalchemy import Connection

    from lambent_server.services import Services

app = typer.Typer(add_completion=False, no_args_is_help=True, help="List, cancel or requeue jobs by filter.")

StateOption = Annotated[list[str], typer.Option("--state", help="Only in this state; repeatable.")]
LabelOption = Annotated[
    list[str], typer.Option("--label", metavar="NAME=VALUE", help="Only with this label; repeatable.")
]
KindOption = Annotated[str, typer.Option(help="Only of this kind: train, check, render, ...")]
TenantOption = Annotated[str, typer.Option(help="Only of this tenant.")]
OlderOption = Annotated[str, typer.Option("--older-than", metavar="AGE", help="Only older: 30m, 12h, 7d.")]
CodeOption = Annotated[str, typer.Option("--error", metavar="CODE", help="Only with this code of error.")]
IdsArgument = Annotated[list[str] | None, typer.Argument(metavar="[JOB]...", help="Only these jobs.")]
YesOption = Annotated[bool, typer.Option("--yes", help="Do it; without, the jobs are only listed.")]
LIMIT = 10_000


def _found(services: "Services", **given: Any) -> list[dict[str, Any]]:
    """Return the jobs of a filter, oldest first, at most LIMIT."""
    from lambent_server.core.clock import now
    from lambent_server.database.schema import job_labels, jobs
    from lambent_server.database.tenancy import across_tenants

    conditions = [
        jobs.c[name] == value
        for name, value in (("kind", given["kind"]), ("tenant_id", given["tenant"]))
        if value
    ]
    if given["ids"]:
        conditions.append(jobs.c.id.in_(given["ids"]))
    if given["states"]:
        conditions.append(jobs.c.state.in_(given["states"]))
    if given["older"]:
        conditions.append(jobs.c.created_at < now() - age(given["older"]))
    for pair in given["labels"]:
        name, equals, value = pair.partition("=")
        if not equals:
            raise typer.BadParameter(f"{pair!r} is not NAME=VALUE")
        labelled = across_tenants(job_labels, job_labels.c.job_id).where(
            job_labels.c.name == name, job_labels.c.value == value
        )
        conditions.append(jobs.c.id.in_(labelled))
    statement = across_tenants(jobs).where(*conditions).order_by(jobs.c.id).limit(LIMIT)
    with services.database.read() as connection:
        rows = [dict(row) for row in connection.execute(statement).mappings()]
    code = given["code"]
    return [row for row in rows if not code or (row["error"] or {}).get("code") == code]


def _show(rows: list[dict[str, Any]], as_json: bool) -> None:
    from lambent_server.core.clock import rfc3339

    shown = [
        {
            **{name: row[name] for name in ("id", "tenant_id", "state", "kind", "priority", "run", "labels")},
            "created_at": rfc3339(row["created_at"]),
            "error": (row["error"] or {}).get("code", ""),
        }
        for row in rows
    ]
    if as_json:
        for each in shown:
            typer.echo(json.dumps(each))
        return
    names = ("id", "tenant_id", "state", "kind", "priority", "run", "created_at", "error")
    titles = ("JOB", "TENANT", "STATE", "KIND", "PRIORITY", "RUN", "CREATED", "ERROR")
    columns([titles, *(tuple(str(each[name]) for name in names) for each in shown)])


@app.command("list")
def list_jobs(
    ids: IdsArgument = None,
    state: StateOption = [],  # noqa: B006 - typer reads it once
    label: LabelOption = [],  # noqa: B006
    kind: KindOption = "",
    tenant: TenantOption = "",
    older: OlderOption = "",
    code: CodeOption = "",
    data: DataOption = None,
    database: DatabaseOption = None,
    as_json: JsonOption = False,
) -> None:
    """List jobs of all tenants, oldest first."""
    given = {"ids": ids, "states": state, "labels": label, "kind": kind, "tenant": tenant}
    with opened(data, database) as services:
        _show(_found(services, **given, older=older, code=code), as_json)


@app.command()
def cancel(
    ids: IdsArgument = None,
    state: StateOption = [],  # noqa: B006
    label: LabelOption = [],  # noqa: B006
    kind: KindOption = "",
    tenant: TenantOption = "",
    older: OlderOption = "",
    yes: YesOption = False,
    data: DataOption = None,
    database: DatabaseOption = None,
    as_json: JsonOption = False,
) -> None:
    """Cancel unfinished jobs; those that run are `cancelling` until their process is gone."""
    from lambent_server.accounts import audit
    from lambent_server.accounts.who import operator
    from lambent_server.jobs import queries as job_queries
    from lambent_server.jobs.rows import FINAL, owner

    def act(connection: "Connection", job: dict[str, Any], _services: "Services") -> None:
        current = job_queries.require_job(connection, owner(job), job["id"], lock=True)
        job_queries.cancel(connection, current)
        audit.record(connection, operator(owner(job)), "jobs cancel", job["id"])

    given = {"ids": ids, "states": state, "labels": label, "kind": kind, "tenant": tenant, "older": older}
    with opened(data, database) as services:
        rows = [row for row in _found(services, **given, code="") if row["state"] not in FINAL]
        _each(services, rows, act, "cancelled", yes=yes, as_json=as_json)


@app.command()
def requeue(
    ids: IdsArgument = None,
    state: StateOption = [],  # noqa: B006
    label: LabelOption = [],  # noqa: B006
    kind: KindOption = "",
    tenant: TenantOption = "",
    older: OlderOption = "",
    code: CodeOption = "",
    yes: YesOption = False,
    data: DataOption = None,
    database: DatabaseOption = None,
    as_json: JsonOption = False,
) -> None:
    """Queue failed and cancelled jobs again, each as a new job with the same request."""
    from lambent_server.accounts import audit
    from lambent_server.accounts.who import operator
    from lambent_server.jobs import queries as job_queries
    from lambent_server.jobs.rows import CANCELLED, FAILED, owner
    from lambent_server.renders import rows as render_rows

    def act(connection: "Connection", job: dict[str, Any], services: "Services") -> None:
        if job["order_id"] is None:
            made = job_queries.submit_again(connection, owner(job), job, services)
        else:
            made = render_rows.queue_again(connection, owner(job), job, services)
        audit.record(connection, operator(owner(job)), "jobs requeue", job["id"], details={"job": made["id"]})

    given = {"ids": ids, "states": state, "labels": label, "kind": kind, "tenant": tenant, "older": older}
    with opened(data, database) as services:
        rows = [row for row in _found(services, **given, code=code) if row["state"] in (FAILED, CANCELLED)]
        _each(services, rows, act, "queued again", yes=yes, as_json=as_json)


def _each(
    services: "Services",
    rows: list[dict[str, Any]],
    act: Any,
    done: str,
    *,
    yes: bool,
    as_json: bool,
) -> None:
    """Do it to every job, or show which; exit code 4 when one was refused."""
    from lambent_server.api.problems import Problem

    if not yes:
        _show(rows, as_json)
        typer.echo(f"{len(rows)} jobs; nothing was changed: add --yes", err=True)
        return
    refused = 0
    for row in rows:
        try:
            with services.database.write() as connection:
                act(connection, row, services)
        except Problem as problem:
            refused += 1
            typer.echo(f"{row['id']}: {problem.code}: {problem.detail}", err=True)
            continue
        typer.echo(json.dumps({"id": row["id"], "done": done}) if as_json else f"{row['id']} {done}")
    if refused:
        raise typer.Exit(4)
