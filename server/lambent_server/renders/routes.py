"""Pictures of bundles: renders of one bundle, and batches that are split into several jobs."""

from typing import Annotated

from fastapi import APIRouter, Query
from sqlalchemy import Connection

from lambent_server.accounts import audit
from lambent_server.api.messages import Job
from lambent_server.api.pagination import FilePageFilter, PageFilter, select_newest, select_ordered
from lambent_server.api.problems import conflict
from lambent_server.api.resources import IdempotencyKey, ResourceRoute, digest_of
from lambent_server.database.model import ArtifactRow, OrderRow
from lambent_server.database.schema import artifacts, render_orders
from lambent_server.database.tenancy import Tenant, rows
from lambent_server.http.common import Id, ServicesOf, TenantOf, WhoOf, problems
from lambent_server.jobs import queries as job_queries
from lambent_server.jobs.rows import CANCELLED, CANCELLING, QUEUED, RETRY_WAIT, RUNNING
from lambent_server.renders import rows as render_rows
from lambent_server.renders.messages import (
    Batch,
    BatchArtifact,
    BatchArtifactList,
    BatchList,
    NewBatch,
    NewRender,
)
from lambent_server.storage.store import blob_url

router = APIRouter(tags=["pictures"], route_class=ResourceRoute)


@router.post("/v1/renders", status_code=202, responses=problems(400, 403, 404, 413, 422, 429, 507))
def submit_render(
    services: ServicesOf, tenant: TenantOf, who: WhoOf, body: NewRender, key: IdempotencyKey = None
) -> Job:
    """Queue pictures of one bundle as one job; the pictures are its artifacts."""
    services.require_disk()
    with services.database.write() as connection:
        row = render_rows.submit_once(
            connection,
            tenant,
            render_rows.RENDER,
            body.as_batch(),
            services,
            key,
            digest_of(render_rows.RENDER, body),
        )
        job = render_rows.first_job(connection, tenant, row.id)
        shown = job_queries.show(connection, tenant, job)
        audit.record(connection, who, "submit_render", shown.id)
    services.wakeups.signal()
    return shown


@router.post("/v1/batches", status_code=202, responses=problems(400, 403, 404, 413, 422, 429, 507))
def submit_batch(
    services: ServicesOf, tenant: TenantOf, who: WhoOf, body: NewBatch, key: IdempotencyKey = None
) -> Batch:
    """Queue assets x environments x cameras x qualities, split into jobs."""
    services.require_disk()
    with services.database.write() as connection:
        row = render_rows.submit_once(
            connection, tenant, render_rows.BATCH, body, services, key, digest_of(render_rows.BATCH, body)
        )
        batch = render_rows.show(connection, tenant, row)
        audit.record(connection, who, "submit_batch", batch.id)
    services.wakeups.signal()
    return batch


@router.get("/v1/batches", responses=problems(422))
def list_batches(services: ServicesOf, tenant: TenantOf, given: Annotated[PageFilter, Query()]) -> BatchList:
    """List batches, newest first."""
    with services.database.read() as connection:
        page, cursor = select_newest(
            connection, tenant, OrderRow, render_orders.c.kind == render_rows.BATCH, page=given
        )
        return BatchList(
            items=[render_rows.show(connection, tenant, row) for row in page], next_cursor=cursor
        )


@router.get("/v1/batches/{batch_id:id}", responses=problems(404))
def get_batch(services: ServicesOf, tenant: TenantOf, batch_id: Id) -> Batch:
    """Return a batch."""
    with services.database.read() as connection:
        return _show(connection, tenant, batch_id)


def _show(connection: Connection, tenant: Tenant, batch_id: str) -> Batch:
    row = render_rows.require_order(connection, tenant, batch_id, render_rows.BATCH)
    return render_rows.show(connection, tenant, row)


@router.post("/v1/batches/{batch_id:id}:cancel", status_code=202, responses=problems(403, 404, 409))
def cancel_batch(services: ServicesOf, tenant: TenantOf, who: WhoOf, batch_id: Id) -> Batch:
    """Cancel every job of a batch; published files stay."""
    with audit.recorded(services.database, who, "cancel_batch", batch_id) as connection:
        row = render_rows.require_order(connection, tenant, batch_id, render_rows.BATCH, lock=True)
        states = set()
        for job in render_rows.newest_jobs(connection, tenant, row.id):
            job = job_queries.require_job(connection, tenant, job.id, lock=True)
            states.add(job.state)
            job_queries.cancel(connection, job)
        if not states & {QUEUED, RETRY_WAIT, RUNNING, CANCELLING, CANCELLED}:
            raise conflict("batch_final", f"every job of batch {batch_id} has ended; that is final")
        batch = _show(connection, tenant, batch_id)
    services.wakeups.signal()
    return batch


@router.post("/v1/batches/{batch_id:id}:retry", status_code=202, responses=problems(403, 404, 409, 429, 507))
def retry_batch(services: ServicesOf, tenant: TenantOf, who: WhoOf, batch_id: Id) -> Batch:
    """Queue the failed and cancelled parts of a batch again, as new jobs."""
    services.require_disk()
    with audit.recorded(services.database, who, "retry_batch", batch_id) as connection:
        row = render_rows.require_order(connection, tenant, batch_id, render_rows.BATCH, lock=True)
        render_rows.retry(connection, tenant, row, services)
        batch = _show(connection, tenant, batch_id)
    services.wakeups.signal()
    return batch


@router.get("/v1/batches/{batch_id:id}/artifacts", responses=problems(404, 422))
def list_batch_artifacts(
    services: ServicesOf, tenant: TenantOf, batch_id: Id, given: Annotated[FilePageFilter, Query()]
) -> BatchArtifactList:
    """Return the files that the jobs of a batch have published, by name."""
    with services.database.read() as connection:
        row = render_rows.require_order(connection, tenant, batch_id, render_rows.BATCH)
        identifiers = [job.id for job in render_rows.newest_jobs(connection, tenant, row.id)]
        page, cursor = select_ordered(
            connection,
            ArtifactRow,
            rows(tenant, artifacts).where(artifacts.c.job_id.in_(identifiers)),
            [artifacts.c.name, artifacts.c.job_id],
            page=given,
        )
        items = [BatchArtifact.of(each, url=blob_url(each.sha256)) for each in page]
    return BatchArtifactList(items=items, next_cursor=cursor)
