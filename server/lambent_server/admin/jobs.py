"""`lambent admin jobs`: list, cancel or requeue jobs of all tenants by filter."""

import json
from collections.abc import Callable
from enum import StrEnum
from typing import Annotated

import typer
from sqlalchemy import Connection

from lambent_server.accounts import audit
from lambent_server.accounts.who import operator
from lambent_server.admin.opened import (
    JsonOption,
    OlderOption,
    TenantOption,
    YesOption,
    age,
    opened,
    print_rows,
)
from lambent_server.api.problems import Problem
from lambent_server.cli import DatabaseOption, DataOption
from lambent_server.core.clock import now, rfc3339
from lambent_server.database.model import JobRow
from lambent_server.database.rows import many
from lambent_server.database.schema import job_labels
from lambent_server.database.schema import jobs as job_table
from lambent_server.database.tenancy import across_tenants
from lambent_server.jobs import queries as job_queries
from lambent_server.jobs.rows import CANCELLED, FAILED, FINAL, owner
from lambent_server.renders import rows as render_rows
from lambent_server.services import Services

LIMIT = 10_000
Act = Callable[[Connection, JobRow, Services], None]
_SHOWN = ("id", "tenant_id", "state", "kind", "priority", "run", "labels")
_COLUMNS = ("id", "tenant_id", "state", "kind", "priority", "run", "created_at", "error")


class JobAction(StrEnum):
    """What `lambent admin jobs` does."""

    LIST = "list"
    CANCEL = "cancel"
    REQUEUE = "requeue"


def jobs(
    action: Annotated[
        JobAction,
        typer.Argument(
            help="list, oldest first; cancel unfinished ones; requeue failed and cancelled ones, each as a "
            "new job with the same request."
        ),
    ],
    ids: Annotated[list[str] | None, typer.Argument(metavar="JOB", help="Only these jobs.")] = None,
    state: Annotated[list[str] | None, typer.Option(help="Only in this state; repeatable.")] = None,
    label: Annotated[
        list[str] | None, typer.Option(metavar="NAME=VALUE", help="Only with this label; repeatable.")
    ] = None,
    kind: Annotated[str, typer.Option(help="Only of this kind: train, check, render, ...")] = "",
    tenant: TenantOption = "",
    older: OlderOption = "",
    code: Annotated[str, typer.Option("--error", metavar="CODE", help="Only with this code of error.")] = "",
    yes: YesOption = False,
    data: DataOption = None,
    database: DatabaseOption = None,
    as_json: JsonOption = False,
) -> None:
    """List, cancel or requeue jobs of all tenants. Exit code 4 when one was refused."""
    if yes and action is JobAction.LIST:
        raise typer.BadParameter("list changes nothing; leave out --yes")
    conditions = [
        job_table.c[name] == value for name, value in (("kind", kind), ("tenant_id", tenant)) if value
    ]
    if ids:
        conditions.append(job_table.c.id.in_(ids))
    if state:
        conditions.append(job_table.c.state.in_(state))
    if older:
        conditions.append(job_table.c.created_at < now() - age(older))
    for pair in label or ():
        name, equals, value = pair.partition("=")
        if not equals:
            raise typer.BadParameter(f"{pair!r} is not NAME=VALUE")
        labelled = across_tenants(job_labels, job_labels.c.job_id).where(
            job_labels.c.name == name, job_labels.c.value == value
        )
        conditions.append(job_table.c.id.in_(labelled))
    statement = across_tenants(job_table).where(*conditions).order_by(job_table.c.id).limit(LIMIT)
    with opened(data, database) as services:
        with services.database.read() as connection:
            rows = many(connection, statement, JobRow)
        rows = [row for row in rows if not code or (row.error or {}).get("code") == code]
        if action is JobAction.CANCEL:
            rows = [row for row in rows if row.state not in FINAL]
            _each(services, rows, _cancel, "cancelled", yes=yes, as_json=as_json)
        elif action is JobAction.REQUEUE:
            rows = [row for row in rows if row.state in (FAILED, CANCELLED)]
            _each(services, rows, _requeue, "queued again", yes=yes, as_json=as_json)
        else:
            _show(rows, as_json)


def _show(rows: list[JobRow], as_json: bool) -> None:
    shown = [
        {
            **{name: getattr(row, name) for name in _SHOWN},
            "created_at": rfc3339(row.created_at),
            "error": (row.error or {}).get("code", ""),
        }
        for row in rows
    ]
    print_rows(shown, _COLUMNS, as_json)


def _cancel(connection: Connection, job: JobRow, _services: Services) -> None:
    current = job_queries.require_job(connection, owner(job), job.id, lock=True)
    job_queries.cancel(connection, current)
    audit.record(connection, operator(owner(job)), "jobs cancel", job.id)


def _requeue(connection: Connection, job: JobRow, services: Services) -> None:
    again = job_queries.submit_again if job.order_id is None else render_rows.queue_again
    made = again(connection, owner(job), job, services)
    audit.record(connection, operator(owner(job)), "jobs requeue", job.id, details={"job": made.id})


def _each(services: Services, rows: list[JobRow], act: Act, done: str, *, yes: bool, as_json: bool) -> None:
    """Do it to every job, or show which; exit code 4 when one was refused."""
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
            typer.echo(f"{row.id}: {problem.code}: {problem.detail}", err=True)
            continue
        typer.echo(json.dumps({"id": row.id, "done": done}) if as_json else f"{row.id} {done}")
    if refused:
        raise typer.Exit(4)
