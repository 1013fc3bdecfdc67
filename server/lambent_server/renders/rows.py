"""Database rows of picture orders: the request, the jobs that render it, and their progress."""

import json
from collections.abc import Sequence
from typing import Any

from lambent_core.pictures import RenderCameras, RenderSpec, clashes, safe_name
from sqlalchemy import ColumnElement, Connection, FromClause, case, false, func, select

from lambent_server.api.idempotency import made_before
from lambent_server.api.problems import Detail, Problem, conflict, invalid, not_found
from lambent_server.cluster.membership import total_slots
from lambent_server.core.clock import new_id, now
from lambent_server.database.model import BundleFileRow, BundleRow, EnvironmentRow, JobRow, OrderRow
from lambent_server.database.rows import many, one
from lambent_server.database.schema import (
    bundle_files,
    events,
    jobs,
    render_orders,
)
from lambent_server.database.tenancy import Tenant, add, find, rows
from lambent_server.executors.chosen import is_on_this_machine
from lambent_server.jobs.queries import check_priority, check_quota, insert_job
from lambent_server.jobs.rows import (
    CANCELLED,
    CANCELLING,
    FAILED,
    FINAL,
    QUEUED,
    SUCCEEDED,
    is_unfinished,
)
from lambent_server.renders.messages import Batch, NewBatch
from lambent_server.services import Services

RENDER = "render"
BATCH = "batch"
KINDS = (RENDER, BATCH)


def submit_once(
    connection: Connection,
    tenant: Tenant,
    kind: str,
    order: NewBatch,
    services: Services,
    key: str | None,
    digest: str,
) -> OrderRow:
    """Queue an order, or return the one that was submitted earlier with this key."""
    order_id = new_id(kind)
    known = made_before(connection, tenant, key, digest, order_id)
    if known is not None:
        return require_order(connection, tenant, known, kind)
    return submit(connection, tenant, kind, order, services, order_id)


def submit(
    connection: Connection, tenant: Tenant, kind: str, order: NewBatch, services: Services, order_id: str
) -> OrderRow:
    """Queue the jobs of an order; raises the problem if it cannot be accepted."""
    order = _named(connection, tenant, order, single=kind == RENDER)
    num_pictures = _count_pictures(connection, tenant, order, services, single=kind == RENDER)
    limit = services.settings.max_batch_pictures
    if num_pictures > limit:
        message = f"{num_pictures} pictures are asked for, {limit} are allowed at once"
        raise invalid("too_many_pictures", "#/cameras", message)
    num_shards = min(order.shards or _num_places(connection, services), num_pictures)
    num_jobs = num_shards + (num_shards > 1)
    check_priority(order.priority, services.settings)
    check_quota(connection, tenant, services, num_jobs)
    connection.execute(
        add(
            tenant,
            render_orders,
            id=order_id,
            kind=kind,
            name=order.name,
            spec=order.spec,
            num_pictures=num_pictures,
            num_shards=num_shards,
            created_at=now(),
        )
    )
    for shard in range(num_jobs):
        _queue(connection, tenant, order_id, kind, shard, order.priority, order.labels)
    return require_order(connection, tenant, order_id, kind)


def _num_places(connection: Connection, services: Services) -> int:
    """Return how many parts of an order can be rendered at the same time."""
    if is_on_this_machine(services.settings):
        return total_slots(connection, services.settings.local_slots)
    return services.capacity.num_places()


def _queue(
    connection: Connection,
    tenant: Tenant,
    order_id: str,
    kind: str,
    shard: int,
    priority: int,
    labels: dict[str, str],
) -> JobRow:
    return insert_job(
        connection,
        tenant,
        kind=kind,
        scene_id="",
        preset="",
        params={},
        gpus=0,
        priority=priority,
        labels=labels,
        seed=0,
        order_id=order_id,
        shard=shard,
    )


def queue_again(connection: Connection, tenant: Tenant, job: JobRow, services: Services) -> JobRow:
    """Queue a new job for the part of an order that `job` was to render."""
    return _queue_parts(connection, tenant, job.part[0], [job], services)[0]


def _queue_parts(
    connection: Connection, tenant: Tenant, order_id: str, parts: Sequence[JobRow], services: Services
) -> list[JobRow]:
    """Queue parts of an order again, and the summary job too if it has ended."""
    last = newest_jobs(connection, tenant, order_id)[-1]
    again = list(parts)
    if last.state in FINAL and last.shard not in {job.shard for job in parts}:
        again += [last] if is_summary(last, _num_shards(connection, tenant, order_id)) else []
    check_quota(connection, tenant, services, len(again))
    return [
        _queue(connection, tenant, order_id, job.kind, job.part[1], job.priority, job.labels) for job in again
    ]


def is_summary(job: JobRow, num_shards: int) -> bool:
    """Return whether a job is the summary, which only creates the table and contact sheet of all parts."""
    return job.shard == num_shards


def _num_shards(connection: Connection, tenant: Tenant, order_id: str) -> int:
    row = find(connection, tenant, OrderRow, order_id)
    assert row is not None
    return row.num_shards


def waits_for_parts(table: FromClause = jobs) -> ColumnElement[bool]:
    """Return the condition that a job is the summary of an order with an unfinished part."""
    parts = jobs.alias()
    # A scalar, not EXISTS: PostgreSQL would read all orders into a hash table.
    going_on = (
        select(parts.c.id)
        .join(render_orders, render_orders.c.id == parts.c.order_id)
        .where(
            parts.c.order_id == table.c.order_id,
            parts.c.shard < table.c.shard,
            is_unfinished(parts),
            render_orders.c.num_shards == table.c.shard,
        )
        .limit(1)
        .correlate(table)
        .scalar_subquery()
    )
    # As a choice, which PostgreSQL takes to be as often true as false and not to hold for nearly every job.
    return case((table.c.order_id.is_(None), false()), else_=going_on.is_not(None))


def require_order(
    connection: Connection, tenant: Tenant, order_id: str, kind: str, *, lock: bool = False
) -> OrderRow:
    """Return the order's row."""
    row = find(connection, tenant, OrderRow, order_id, lock=lock)
    if row is None or row.kind != kind:
        raise not_found(kind, order_id)
    return row


def first_job(connection: Connection, tenant: Tenant, order_id: str) -> JobRow:
    """Return the job as which an order was first queued."""
    statement = rows(tenant, jobs).where(jobs.c.order_id == order_id).order_by(jobs.c.id).limit(1)
    (job,) = many(connection, statement, JobRow)
    return job


def newest_jobs(connection: Connection, tenant: Tenant, order_id: str) -> list[JobRow]:
    """Return the newest job of every part of an order, by part; the summary comes last."""
    statement = rows(tenant, jobs).where(jobs.c.order_id == order_id).order_by(jobs.c.id)
    by_part = {job.part[1]: job for job in many(connection, statement, JobRow)}
    return [by_part[shard] for shard in sorted(by_part)]


def show(connection: Connection, tenant: Tenant, row: OrderRow) -> Batch:
    """Return a batch in the form of the REST interface."""
    newest = newest_jobs(connection, tenant, row.id)
    identifiers = [job.id for job in newest]
    parts = [job for job in newest if not is_summary(job, row.num_shards)]
    failed = rows(tenant, events, func.count()).where(
        events.c.job_id.in_(identifiers), events.c.type == "finding"
    )
    return Batch.of(
        row,
        state=_state([job.state for job in newest]),
        num_done=sum((job.progress or {}).get("step", 0) for job in parts),
        num_failed=connection.execute(failed).scalar_one(),
        job_ids=identifiers,
    )


def _state(states: Sequence[str]) -> Any:
    """Return the combined state of an order from those of its parts."""
    going_on = [state for state in states if state not in FINAL]
    if going_on:
        if CANCELLING in going_on:
            return CANCELLING
        return QUEUED if all(state == QUEUED for state in states) else "running"
    return next((state for state in (FAILED, CANCELLED) if state in states), SUCCEEDED)


def retry(connection: Connection, tenant: Tenant, row: OrderRow, services: Services) -> None:
    """Queue every part of a batch that failed or was cancelled again."""
    again = [job for job in newest_jobs(connection, tenant, row.id) if job.state in (FAILED, CANCELLED)]
    if not again:
        raise conflict("batch_not_ended", f"no job of batch {row.id} has failed or was cancelled")
    _queue_parts(connection, tenant, row.id, again, services)


def _named(connection: Connection, tenant: Tenant, order: NewBatch, *, single: bool) -> NewBatch:
    """Return the order with the environments' names; everything that it refers to must exist."""
    for index, asset in enumerate(order.assets):
        if find(connection, tenant, BundleRow, asset.bundle_id) is None:
            raise _missing("bundle", asset.bundle_id, "#" if single else f"#/assets/{index}")
    lights = []
    for index, light in enumerate(order.environments):
        row = find(connection, tenant, EnvironmentRow, light.environment_id)
        if row is None:
            raise _missing("environment", light.environment_id, f"#/environments/{index}")
        name = light.name or safe_name(row.name.rpartition(".")[0] or row.name)
        lights.append(light.model_copy(update={"name": name}))
    named = order.model_copy(update={"environments": lights})
    for pointer, message in clashes(named):
        raise invalid("name_clash", f"#{pointer}", message)
    return named


def _missing(kind: str, identifier: str, pointer: str) -> Problem:
    return Problem(
        404,
        f"{kind}_not_found",
        f"there is no {kind} {identifier!r}",
        errors=(Detail(f"{pointer}/{kind}_id", f"no such {kind}"),),
    )


def _count_pictures(
    connection: Connection, tenant: Tenant, spec: RenderSpec, services: Services, *, single: bool
) -> int:
    per_asset = len(spec.environments) * len(spec.qualities)
    counts: dict[str, int] = {}
    for asset in spec.assets:
        if asset.bundle_id not in counts:
            names = _camera_names(connection, tenant, asset.bundle_id, services)
            counts[asset.bundle_id] = sum(
                _count_cameras(entry, names, "#/cameras" if single else f"#/cameras/{index}")
                for index, entry in enumerate(spec.cameras)
            )
    return per_asset * sum(counts[asset.bundle_id] for asset in spec.assets)


def _count_cameras(entry: RenderCameras, names: list[str], pointer: str) -> int:
    for index, view in enumerate(entry.views):
        if view not in names:
            shown = ", ".join(names[:8]) or "none"
            message = f"the bundle has no camera {view!r}; it has {shown}"
            raise invalid("camera_unknown", f"{pointer}/views/{index}", message)
    if entry.all_views and not names:
        raise invalid("camera_unknown", f"{pointer}/all_views", "the bundle has no cameras of its own")
    return entry.turntable or len(entry.views) or len(entry.poses) or len(names)


def _camera_names(connection: Connection, tenant: Tenant, bundle_id: str, services: Services) -> list[str]:
    """Return the names of the cameras of a bundle's photographs; none if it does not list them."""
    statement = rows(tenant, bundle_files).where(
        bundle_files.c.bundle_id == bundle_id, bundle_files.c.path == "cameras.json"
    )
    row = one(connection, statement, BundleFileRow)
    if row is None:
        return []
    try:
        entries = json.loads(services.store.read_all(row.sha256))["cameras"]
        return [str(each.get("name", f"camera_{index:03d}")) for index, each in enumerate(entries)]
    except (ValueError, KeyError, TypeError, AttributeError):
        return []
