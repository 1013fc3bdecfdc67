"""Retention: what an organisation keeps no longer than so many seconds, unless it is labelled `keep`."""

import contextlib
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import structlog
from sqlalchemy import Connection, Select

from lambent_server.accounts import audit, organisations
from lambent_server.accounts.scopes import ALL
from lambent_server.accounts.who import Who
from lambent_server.api import labels as label_rows
from lambent_server.api.problems import Problem
from lambent_server.core.clock import now
from lambent_server.database.cluster_schema import run_logs
from lambent_server.database.model import BundleRow, JobRow, SceneRow
from lambent_server.database.schema import bundles, job_labels, jobs, scenes
from lambent_server.database.tenancy import Tenant, find, rows
from lambent_server.jobs import removals
from lambent_server.jobs.logs import forget as forget_logs
from lambent_server.jobs.rows import FINAL
from lambent_server.scenes import rows as scene_rows
from lambent_server.services import Services

log = structlog.get_logger()

Kind = Literal["jobs", "scenes", "bundles", "logs"]
KINDS: tuple[Kind, ...] = get_args(Kind)
KEEP = "keep"
"""Label of what is kept, whatever its value."""
AT_ONCE = 500
"""Things of one kind that one round of the server deletes of an organisation."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Due:
    """Something that is old enough."""

    kind: Kind
    id: str
    since: float
    """When it was made; of jobs and logs, when the job ended."""


def rules_of(connection: Connection, tenant: Tenant) -> dict[Kind, float]:
    """Return the seconds after which an organisation's things of a kind are deleted."""
    row = organisations.find(connection, tenant)
    stored = (row.retention if row is not None else None) or {}
    return {kind: float(stored[kind]) for kind in KINDS if stored.get(kind) is not None}


def due(services: Services, tenant: Tenant, rules: Mapping[Kind, float], limit: int = AT_ONCE) -> list[Due]:
    """Return what the rules would delete now, oldest first, at most `limit` of each kind."""
    things: list[Due] = []
    with services.database.read() as connection:
        for kind in KINDS:
            if kind not in rules:
                continue
            before = now() - rules[kind]
            if kind == "logs":
                pairs = _old_logs(services, connection, tenant, before, limit)
            else:
                pairs = _pairs(connection, _old(tenant, kind, before), limit)
            things += [Due(kind=kind, id=identifier, since=at) for identifier, at in pairs.items()]
    return things


def _old(tenant: Tenant, kind: Kind, before: float) -> Select[Any]:
    """Return a SELECT of id and time of what is old and not labelled, oldest first; of logs, their jobs."""
    if kind in ("jobs", "logs"):
        unlabelled = label_rows.lacking(tenant, jobs.c.id, KEEP, job_labels)
        ended = (jobs.c.state.in_(FINAL), jobs.c.handle.is_(None), jobs.c.finished_at < before)
        return (
            rows(tenant, jobs, jobs.c.id, jobs.c.finished_at)
            .where(*ended, unlabelled)
            .order_by(jobs.c.finished_at)
        )
    table = scenes if kind == "scenes" else bundles
    old = rows(tenant, table, table.c.id, table.c.created_at).where(table.c.created_at < before)
    return old.where(label_rows.lacking(tenant, table.c.id, KEEP)).order_by(table.c.created_at)


def _pairs(connection: Connection, statement: Select[Any], limit: int) -> dict[str, float]:
    return {str(identifier): float(at) for identifier, at in connection.execute(statement.limit(limit))}


def _old_logs(
    services: Services, connection: Connection, tenant: Tenant, before: float, limit: int
) -> dict[str, float]:
    """Return old jobs that have a log, on this machine or as a copy for all, with when they ended.

    The folders say which jobs have one here: they go with their logs, while jobs may stay for ever.
    """
    ended = _old(tenant, "logs", before)
    copied = jobs.c.id.in_(rows(tenant, run_logs, run_logs.c.job_id))
    with_logs = _pairs(connection, ended.where(copied), limit)
    folders = sorted(folder.name for folder in services.settings.runs.iterdir())
    for start in range(0, len(folders), AT_ONCE):
        if len(with_logs) >= limit:
            break
        some = folders[start : start + AT_ONCE]
        here = _pairs(connection, ended.where(jobs.c.id.in_(some)), AT_ONCE)
        with_logs |= {job_id: at for job_id, at in here.items() if _logs(services, job_id)}
    return dict(list(with_logs.items())[:limit])


def _logs(services: Services, job_id: str) -> list[Path]:
    """Return the logs of a job's runs on this machine."""
    folder = services.settings.runs / job_id
    return sorted(folder.glob("run-*.log")) if folder.is_dir() else []


def delete(services: Services, who: Who, each: Due) -> bool:
    """Delete one thing and record it; return False if it is needed or labelled by now.

    Files go after the commit: until then the deletion may still be rolled back.
    """
    tenant = who.tenant
    kind: type[JobRow | SceneRow | BundleRow]
    kind = {"jobs": JobRow, "logs": JobRow, "scenes": SceneRow, "bundles": BundleRow}[each.kind]
    try:
        with services.database.write() as connection:
            row = find(connection, tenant, kind, each.id, lock=True)
            if row is None or KEEP in (row.labels or {}):
                return False
            if each.kind == "jobs":
                removals.delete_job(connection, tenant, each.id)
            elif each.kind == "bundles":
                removals.delete_bundle(connection, tenant, each.id)
            elif each.kind == "logs":
                forget_logs(connection, tenant, each.id)
            elif isinstance(row, SceneRow):
                scene_rows.delete(connection, tenant, row)
            audit.record(connection, who, "retention", each.id, details={"kind": each.kind})
    except Problem as problem:
        # An unfinished job needs it: it is due again in the next round.
        log.info("retention_waits", tenant=tenant.id, id=each.id, code=problem.code)
        return False
    if each.kind == "jobs":
        shutil.rmtree(services.settings.runs / each.id, ignore_errors=True)
    elif each.kind == "logs":
        _delete_logs(services, each.id)
    return True


def _delete_logs(services: Services, job_id: str) -> None:
    """Delete the logs of a job on this machine, and its folder if nothing else is in it."""
    for path in _logs(services, job_id):
        path.unlink(missing_ok=True)
    with contextlib.suppress(OSError):
        (services.settings.runs / job_id).rmdir()


def enforce(services: Services, *, only_logs: bool = False) -> int:
    """Apply the rules of all organisations that have them enforced; return how many things were deleted.

    With `only_logs`, only those are deleted that this machine has: the leader does the rest.
    """
    with services.database.read() as connection:
        enforced = [
            Tenant(row.tenant_id)
            for row in organisations.all_of_them(connection)
            if row.retention_enforced and row.retention
        ]
        rules = {tenant: rules_of(connection, tenant) for tenant in enforced}
    num_deleted = 0
    for tenant, own in rules.items():
        who = Who(tenant=tenant, kind="operator", id="retention", scopes=ALL)
        wanted: Mapping[Kind, float] = own
        if only_logs:
            wanted = {kind: age_s for kind, age_s in own.items() if kind == "logs"}
        num_deleted += sum(delete(services, who, each) for each in due(services, tenant, wanted))
    if num_deleted:
        log.info("retention_applied", num_deleted=num_deleted)
    return num_deleted
