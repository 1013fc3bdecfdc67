"""Retry of a job, or of the part of an order that it was to render."""

from fastapi import APIRouter

from lambent_server.accounts import audit
from lambent_server.api.idempotency import made_before, point_to
from lambent_server.api.messages import Job
from lambent_server.api.problems import conflict
from lambent_server.api.resources import IdempotencyKey, ResourceRoute, digest_of
from lambent_server.http.common import Id, ServicesOf, TenantOf, WhoOf, problems
from lambent_server.jobs import queries as job_queries
from lambent_server.jobs.rows import CANCELLED, FAILED
from lambent_server.renders import rows as render_rows

router = APIRouter(tags=["jobs"], route_class=ResourceRoute)


@router.post("/v1/jobs/{job_id:id}:retry", status_code=202, responses=problems(404, 409, 422, 429, 507))
def retry_job(
    services: ServicesOf, tenant: TenantOf, who: WhoOf, job_id: Id, key: IdempotencyKey = None
) -> Job:
    """Queue a new job with the request of one that failed or was cancelled; the old one stays unchanged."""
    services.require_disk()
    with services.database.write() as connection:
        known = made_before(connection, tenant, key, digest_of("retry", job_id), "")
        if known is not None:
            return job_queries.show(connection, tenant, job_queries.require_job(connection, tenant, known))
        job = job_queries.require_job(connection, tenant, job_id)
        if job.state not in (FAILED, CANCELLED):
            raise conflict(
                "job_not_ended", f"job {job_id} is {job.state}; only failed and cancelled jobs can"
            )
        if job.order_id is None:
            fresh = job_queries.submit_again(connection, tenant, job, services)
        else:
            fresh = render_rows.queue_again(connection, tenant, job, services)
        point_to(connection, tenant, key, fresh.id)
        shown = job_queries.show(connection, tenant, fresh)
        audit.record(connection, who, "retry_job", job_id, details={"job": fresh.id})
    services.wakeups.signal()
    return shown
