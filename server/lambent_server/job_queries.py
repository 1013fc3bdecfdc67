"""Queries of jobs, and the submission of new ones."""

import json
from collections.abc import Sequence
from functools import cache
from importlib import resources
from typing import Any

from sqlalchemy import Connection, func, or_, select

from lambent_server import bake_rows
from lambent_server.clock import new_id, now, rfc3339
from lambent_server.database.schema import job_labels, jobs, scenes
from lambent_server.database.tenancy import Tenant, add, find, rows
from lambent_server.idempotency import made_before
from lambent_server.job_parameters import SIZE_STEP, odd_size
from lambent_server.job_rows import (
    CANCELLED,
    CANCELLING,
    FINAL,
    QUEUED,
    RETRY_WAIT,
    RUNNING,
    NewEvent,
    append_event,
    move,
)
from lambent_server.messages import Event, Job, NewJob, Preset
from lambent_server.pagination import select_newest
from lambent_server.problems import Detail, Problem, conflict, invalid, not_found
from lambent_server.services import Services
from lambent_server.store import blob_url

Row = dict[str, Any]


@cache
def presets() -> tuple[dict[str, Preset], str]:
    """Return the presets by name and the name of the default one."""
    text = resources.files("lambent_server").joinpath("presets.json").read_text(encoding="utf-8")
    table = json.loads(text)
    return {each["name"]: Preset(**each) for each in table["presets"]}, table["default"]


def require_preset(name: str) -> Preset:
    """Return the preset of this name."""
    known, _ = presets()
    if name not in known:
        message = f"there is no preset {name!r}; there are {', '.join(known)}"
        raise invalid("preset_unknown", "#/preset", message)
    return known[name]


def require_job(connection: Connection, tenant: Tenant, job_id: str, *, lock: bool = False) -> Row:
    """Return the job's row."""
    row = find(connection, tenant, jobs, job_id, lock=lock)
    if row is None:
        raise not_found("job", job_id)
    return dict(row)


def _time(at: float | None) -> str | None:
    return None if at is None else rfc3339(at)


def show(connection: Connection, tenant: Tenant, row: Any) -> Job:
    """Return the job in the form of the REST interface."""
    return show_all(connection, tenant, [row])[0]


def show_all(connection: Connection, tenant: Tenant, found: Sequence[Any]) -> list[Job]:
    """Return jobs in the form of the REST interface; their scenes are looked up together."""
    wanted = {row["scene_id"] for row in found}
    columns = (scenes.c.id, scenes.c.name, scenes.c.thumbnail_sha256)
    known = connection.execute(rows(tenant, scenes, *columns).where(scenes.c.id.in_(wanted))).mappings()
    by_id = {scene["id"]: scene for scene in known}
    return [_show(row, by_id.get(row["scene_id"])) for row in found]


def _show(row: Any, scene: Any) -> Job:
    return Job(
        **{
            name: row[name]
            for name in [
                "id",
                "kind",
                "scene_id",
                "preset",
                "params",
                "gpus",
                "priority",
                "labels",
                "seed",
                "state",
                "run",
                "progress",
                "error",
                "bundle_id",
            ]
        },
        scene_name="" if scene is None else scene["name"],
        batch_id=row["order_id"] if row["kind"] == "batch" else None,
        thumbnail_url=blob_url(row["preview_sha256"] or (scene and scene["thumbnail_sha256"])),
        created_at=rfc3339(row["created_at"]),
        started_at=_time(row["started_at"]),
        finished_at=_time(row["finished_at"]),
        retry_at=_time(row["retry_at"]),
        last_event=row["event_seq"],
    )


def show_event(row: Any) -> Event:
    """Return an event of a job's history in the form of the REST interface."""
    names = ["job_id", "seq", "type", "run", "state", "progress", "message", "sha256", "name"]
    return Event(at=rfc3339(row["at"]), **{name: row[name] for name in names})


def order_of(row: Row) -> NewJob:
    """Return the request with which the job was submitted."""
    names = ["scene_id", "preset", "params", "gpus", "priority", "labels", "kind", "seed"]
    return NewJob(**{name: row[name] for name in names})


def submit_once(
    connection: Connection, tenant: Tenant, order: NewJob, services: Services, key: str | None, digest: str
) -> Row:
    """Add a job to the queue, or return the one that was submitted earlier with this key.

    Sizes that runs round are refused here, where somebody asks for them, and not when a job of an earlier
    release is tried again.
    """
    job_id = new_id("job")
    known = made_before(connection, tenant, key, digest, job_id)
    if known is not None:
        return require_job(connection, tenant, known)
    odd = odd_size(order.params)
    if odd is not None:
        message = f"sizes of textures are multiples of {SIZE_STEP} texels, not {order.params[odd]}"
        raise invalid("setting_invalid", f"#/params/{odd}", message)
    return submit(connection, tenant, order, services, job_id)


def submit(
    connection: Connection, tenant: Tenant, order: NewJob, services: Services, job_id: str | None = None
) -> Row:
    """Add a job to the queue; raises the problem if it cannot be accepted."""
    gpus = _check_order(order, services)
    scene = find(connection, tenant, scenes, order.scene_id)
    if scene is None:
        raise Problem(
            404,
            "scene_not_found",
            f"there is no scene {order.scene_id!r}",
            errors=(Detail("#/scene_id", "no such scene"),),
        )
    if scene["state"] == "open":
        raise conflict("scene_not_committed", "the upload of this scene is not finished; call :commit first")
    if scene["state"] == "rejected":
        findings = (scene["report"] or {}).get("findings", [])
        raise conflict(
            "scene_rejected",
            "this scene cannot be used; fix the problems listed in `findings`",
            findings=findings,
        )
    if order.kind == bake_rows.KIND:
        bake_rows.check_order(connection, tenant, order)
    check_quota(connection, tenant, services, 1)
    return insert_job(
        connection,
        tenant,
        job_id,
        kind=order.kind,
        scene_id=order.scene_id,
        preset=order.preset,
        params=order.params,
        gpus=gpus,
        priority=order.priority,
        labels=order.labels,
        seed=order.seed,
    )


def check_quota(connection: Connection, tenant: Tenant, services: Services, num_jobs: int) -> None:
    """Refuse more unfinished jobs than the tenant may have."""
    if connection.dialect.name == "postgresql":
        # No other transaction can count until this one ends: SQLite has only one writer anyway.
        connection.execute(select(func.pg_advisory_xact_lock(func.hashtext(f"quota {tenant.id}"))))
    active = rows(tenant, jobs, func.count()).where(jobs.c.state.not_in(FINAL))
    in_use = connection.execute(active).scalar_one()
    limit = services.settings.max_queued_jobs
    if in_use + num_jobs > limit:
        raise Problem(
            429,
            "quota_jobs",
            f"{in_use} jobs are unfinished, {limit} are allowed",
            retryable=True,
            headers={"retry-after": "30"},
            members={"quota": {"name": "max_queued_jobs", "limit": limit, "used": in_use}},
        )


def insert_job(
    connection: Connection,
    tenant: Tenant,
    job_id: str | None = None,
    *,
    labels: dict[str, str],
    **values: Any,
) -> Row:
    """Add a row to the queue; `values` are its other columns."""
    identifier = job_id or new_id("job")
    common = {"state": QUEUED, "created_at": now(), "updated_at": now(), "adjustments": {}}
    connection.execute(add(tenant, jobs, id=identifier, labels=labels, **values, **common))
    for name, value in labels.items():
        connection.execute(add(tenant, job_labels, job_id=identifier, name=name, value=value))
    job = require_job(connection, tenant, identifier)
    append_event(connection, job, NewEvent(type="state", state=QUEUED))
    return require_job(connection, tenant, identifier)


def cancel(connection: Connection, job: Row) -> None:
    """Request the cancellation of a job; does nothing if it has ended."""
    if job["state"] in (QUEUED, RETRY_WAIT):
        move(connection, job, CANCELLED, "cancelled before it started")
    elif job["state"] == RUNNING:
        move(connection, job, CANCELLING, "cancel asked for", stop_reason="cancel", stop_at=None)


def _check_order(order: NewJob, services: Services) -> int:
    """Return how many GPUs the job gets."""
    preset = require_preset(order.preset)
    available = max_gpus(services)
    wanted = order.gpus
    if wanted is None:
        wanted = min(preset.gpus, available) if order.kind == "train" else 0
        if wanted < preset.gpus and order.kind == "train":
            message = (
                f'preset {order.preset!r} needs a GPU, and there is none; set "gpus": 0 to run it anyway'
            )
            raise invalid("unsatisfiable_resources", "#/gpus", message)
    if wanted > available:
        message = f"a job can have {available} GPU(s) on this server, not {wanted}"
        raise invalid("unsatisfiable_resources", "#/gpus", message)
    return wanted


def max_gpus(services: Services) -> int:
    """Return how many GPUs one job can have; a run uses at most one."""
    return min(services.local_gpus, 1)


def select_page(
    connection: Connection,
    tenant: Tenant,
    *,
    states: Sequence[str] = (),
    kinds: Sequence[str] = (),
    labels: Sequence[tuple[str, ...]] = (),
    scene_id: str | None = None,
    words: str = "",
    oldest_first: bool = False,
    limit: int,
    cursor: str | None,
) -> tuple[list[Row], str | None]:
    """Return up to `limit` jobs, newest or oldest first, and the cursor of the next page.

    `words` are part of the scene's name, in any case, or begin the job's id or its preset's name.
    """

    def narrow(statement: Any) -> Any:
        if scene_id is not None:
            statement = statement.where(jobs.c.scene_id == scene_id)
        if states:
            statement = statement.where(jobs.c.state.in_(states))
        if kinds:
            statement = statement.where(jobs.c.kind.in_(kinds))
        if words:
            named = rows(tenant, scenes, scenes.c.id).where(scenes.c.name.icontains(words, autoescape=True))
            begins = (column.startswith(words, autoescape=True) for column in (jobs.c.id, jobs.c.preset))
            statement = statement.where(or_(jobs.c.scene_id.in_(named), *begins))
        for name, value in labels:
            labelled = rows(tenant, job_labels, job_labels.c.job_id).where(
                job_labels.c.name == name, job_labels.c.value == value
            )
            statement = statement.where(jobs.c.id.in_(labelled))
        return statement

    return select_newest(
        connection, tenant, jobs, limit=limit, cursor=cursor, narrow=narrow, oldest_first=oldest_first
    )
