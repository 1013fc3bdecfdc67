"""Queries of jobs, and the submission of new ones."""

import json
from collections.abc import Sequence
from functools import cache
from importlib import resources
from typing import Any

from sqlalchemy import Connection, Select

from lambent_server.accounts import quotas
from lambent_server.accounts.makers import columns_of, maker_of
from lambent_server.accounts.who import NOBODY, Maker
from lambent_server.api import labels as label_rows
from lambent_server.api.change_messages import JobChange
from lambent_server.api.idempotency import made_before
from lambent_server.api.messages import Job, NewJob, Preset
from lambent_server.api.pagination import PageFilter, read_page
from lambent_server.api.parameters import SIZE_STEP, odd_size
from lambent_server.api.problems import Detail, Problem, conflict, invalid
from lambent_server.api.resources import require
from lambent_server.cluster.membership import most_gpus
from lambent_server.core.clock import new_id, now
from lambent_server.core.settings import Settings
from lambent_server.database.model import JobRow, SceneRow
from lambent_server.database.schema import job_labels, jobs, scenes
from lambent_server.database.tenancy import Tenant, add, find, rows
from lambent_server.jobs import bakes as bake_rows
from lambent_server.jobs import counts as job_counts
from lambent_server.jobs.pages import Wanted, page
from lambent_server.jobs.rows import (
    CANCELLED,
    CANCELLING,
    FINAL,
    HAS_RUN,
    QUEUED,
    RETRY_WAIT,
    RUNNING,
    NewEvent,
    append_event,
    is_unfinished,
    move,
    set_fields,
)
from lambent_server.services import Services
from lambent_server.storage.bundle_pictures import thumbnail_urls
from lambent_server.storage.store import blob_url
from lambent_server.webhooks.outbox import tell
from lambent_server.webhooks.rows import check_url

LEAST_RESERVED_S = 60.0
"""GPU time that a job counts until it has ended, if its preset has no time budget."""


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


def require_job(connection: Connection, tenant: Tenant, job_id: str, *, lock: bool = False) -> JobRow:
    """Return the job's row."""
    return require(connection, tenant, JobRow, "job", job_id, lock=lock)


def show(connection: Connection, tenant: Tenant, row: JobRow) -> Job:
    """Return the job in the form of the REST interface."""
    return show_all(connection, tenant, [row])[0]


def show_all(connection: Connection, tenant: Tenant, job_rows: Sequence[JobRow]) -> list[Job]:
    """Return jobs in the form of the REST interface; their scenes and bundles are looked up together."""
    wanted = {row.scene_id for row in job_rows}
    columns = (scenes.c.id, scenes.c.name, scenes.c.thumbnail_sha256)
    known = connection.execute(rows(tenant, scenes, *columns).where(scenes.c.id.in_(wanted)))
    by_id = {scene.id: scene for scene in known}
    results = [row.bundle_id for row in job_rows if row.bundle_id]
    made = thumbnail_urls(connection, tenant, results) if results else {}
    return [_show(row, by_id.get(row.scene_id), made.get(row.bundle_id or "")) for row in job_rows]


def _show(row: JobRow, scene: Any, result_url: str | None) -> Job:
    return Job.of(
        row,
        scene_name="" if scene is None else scene.name,
        batch_id=row.order_id if row.kind == "batch" else None,
        thumbnail_url=result_url or blob_url(row.preview_sha256 or (scene and scene.thumbnail_sha256)),
        last_event=row.event_seq,
    )


def order_of(row: JobRow) -> NewJob:
    """Return the request with which the job was submitted."""
    names = ["scene_id", "preset", "params", "gpus", "priority", "labels", "kind", "seed", "webhook"]
    return NewJob(**{name: getattr(row, name) for name in names})


def submit_once(
    connection: Connection,
    tenant: Tenant,
    order: NewJob,
    services: Services,
    key: str | None,
    digest: str,
    maker: Maker = NOBODY,
) -> JobRow:
    """Add a job to the queue, or return the one that was submitted earlier with this key."""
    job_id = new_id("job")
    known = made_before(connection, tenant, key, digest, job_id)
    if known is not None:
        return require_job(connection, tenant, known)
    odd = odd_size(order.params)
    if odd is not None:
        message = f"sizes of textures are multiples of {SIZE_STEP} texels, not {order.params[odd]}"
        raise invalid("setting_invalid", f"#/params/{odd}", message)
    return submit(connection, tenant, order, services, job_id, maker)


def submit(
    connection: Connection,
    tenant: Tenant,
    order: NewJob,
    services: Services,
    job_id: str | None = None,
    maker: Maker = NOBODY,
) -> JobRow:
    """Add a job to the queue; raises the problem if it cannot be accepted."""
    gpus = _check_order(connection, order, services)
    scene = find(connection, tenant, SceneRow, order.scene_id)
    if scene is None:
        raise Problem(
            404,
            "scene_not_found",
            f"there is no scene {order.scene_id!r}",
            errors=(Detail("#/scene_id", "no such scene"),),
        )
    if scene.state == "open":
        raise conflict("scene_not_committed", "the upload of this scene is not finished; call :commit first")
    if scene.state == "rejected":
        findings = (scene.report or {}).get("findings", [])
        raise conflict(
            "scene_rejected",
            "this scene cannot be used; fix the problems listed in `findings`",
            findings=findings,
        )
    if order.webhook is not None:
        check_url(order.webhook, services.settings, "#/webhook")
    if order.kind == bake_rows.KIND:
        bake_rows.check_order(connection, tenant, order)
    budget_s = require_preset(order.preset).budget_s if order.kind == "train" else None
    reserved_s = gpus * max(budget_s or 0.0, LEAST_RESERVED_S)
    check_priority(order.priority, services.settings)
    check_quota(connection, tenant, services, 1, reserved_s)
    return insert_job(
        connection,
        tenant,
        job_id,
        gpu_s_reserved=reserved_s or None,
        kind=order.kind,
        scene_id=order.scene_id,
        preset=order.preset,
        params=order.params,
        gpus=gpus,
        priority=order.priority,
        labels=order.labels,
        seed=order.seed,
        webhook=order.webhook,
        **columns_of(maker),
    )


def check_priority(priority: int, settings: Settings) -> None:
    """Refuse a priority above the one that the operator allows."""
    if priority > settings.max_priority:
        message = (
            f"a job may have a priority of up to {settings.max_priority} here, not {priority}; give a lower "
            "one, or ask the operator (LAMBENT_MAX_PRIORITY)"
        )
        raise invalid("priority_too_high", "#/priority", message)


def submit_again(connection: Connection, tenant: Tenant, job: JobRow, services: Services) -> JobRow:
    """Add a job with the request of another one; its webhook stays that of whoever asked for the first."""
    return submit(connection, tenant, order_of(job), services, maker=maker_of(job))


def num_unfinished(connection: Connection, tenant: Tenant) -> int:
    """Return how many jobs of the tenant have not ended."""
    counts = job_counts.of_tenant(connection, tenant)
    return sum(num_jobs for state, num_jobs in counts.items() if state not in FINAL)


def check_quota(
    connection: Connection, tenant: Tenant, services: Services, num_jobs: int, gpu_s: float = 0.0
) -> None:
    """Refuse more unfinished jobs, or jobs of so many GPU seconds, than the tenant may have."""
    quotas.lock(connection, tenant)
    limits = quotas.quotas_of(connection, tenant, services.settings)
    quotas.check_jobs(limits.jobs, num_unfinished(connection, tenant), num_jobs)
    if gpu_s and limits.gpu_minutes is not None:
        used = quotas.month_used(connection, tenant) + promised_gpu_minutes(connection, tenant)
        quotas.check_gpu_minutes(limits.gpu_minutes, used, gpu_s / 60.0)


def promised_gpu_minutes(connection: Connection, tenant: Tenant) -> float:
    """Return what unfinished jobs count: what was reserved for them, or what their run has used if more."""
    columns = (jobs.c.gpus, jobs.c.gpu_s_reserved, jobs.c.state, jobs.c.run_started_at)
    statement = rows(tenant, jobs, *columns).where(jobs.c.gpus > 0, is_unfinished())
    total_s = 0.0
    for gpus, reserved_s, state, began in connection.execute(statement):
        used_s = gpus * (now() - began) if state in HAS_RUN and began is not None else 0.0
        total_s += max(reserved_s or 0.0, used_s)
    return total_s / 60.0


def insert_job(
    connection: Connection,
    tenant: Tenant,
    job_id: str | None = None,
    *,
    labels: dict[str, str],
    **values: Any,
) -> JobRow:
    """Add a row to the queue; `values` are its other columns."""
    identifier = job_id or new_id("job")
    common = {"state": QUEUED, "created_at": now(), "updated_at": now(), "adjustments": {}}
    connection.execute(add(tenant, jobs, id=identifier, labels=labels, **values, **common))
    label_rows.store(connection, tenant, identifier, labels, job_labels)
    job = require_job(connection, tenant, identifier)
    seq = append_event(connection, job, NewEvent(type="state", state=QUEUED))
    tell(connection, job, QUEUED, seq)
    return require_job(connection, tenant, identifier)


def change_job(
    connection: Connection, tenant: Tenant, job: JobRow, order: JobChange, settings: Settings
) -> None:
    """Change labels or priority of a job; the caller holds its row."""
    values: dict[str, Any] = {}
    if order.priority is not None and order.priority != job.priority:
        if job.state not in (QUEUED, RETRY_WAIT):
            raise conflict("job_not_waiting", f"job {job.id} is {job.state}; only waiting jobs have a turn")
        check_priority(order.priority, settings)
        values["priority"] = order.priority
    if order.labels is not None:
        values["labels"] = label_rows.merged(job.labels, order.labels)
        label_rows.store(connection, tenant, job.id, values["labels"], job_labels)
    if values:
        set_fields(connection, job, **values)


def cancel(connection: Connection, job: JobRow) -> None:
    """Request the cancellation of a job; does nothing if it has ended."""
    if job.state in (QUEUED, RETRY_WAIT):
        move(connection, job, CANCELLED, "cancelled before it started")
    elif job.state == RUNNING:
        move(connection, job, CANCELLING, "cancel asked for", stop_reason="cancel", stop_at=None)


def _check_order(connection: Connection, order: NewJob, services: Services) -> int:
    """Return how many GPUs the job gets."""
    preset = require_preset(order.preset)
    available = max_gpus(connection, services)
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
    if wanted > 1 and order.kind != "train":
        message = f"only training can use several GPUs; a job of the kind {order.kind!r} can have one"
        raise invalid("unsatisfiable_resources", "#/gpus", message)
    return wanted


def max_gpus(connection: Connection, services: Services) -> int:
    """Return how many GPUs one job can have: all of the machine with most of them."""
    return most_gpus(connection, services.capacity.max_gpus())


def select_page(
    connection: Connection,
    tenant: Tenant,
    wanted: Wanted,
    given: PageFilter,
    *,
    oldest_first: bool = False,
) -> tuple[list[JobRow], str | None]:
    """Return a page of jobs, newest or oldest first, and the cursor of the next one."""

    def select_after(after: str | None, num_rows: int) -> Select[Any]:
        return page(connection, tenant, wanted, after=after, oldest_first=oldest_first, num_rows=num_rows)

    return read_page(connection, select_after, given, JobRow)
