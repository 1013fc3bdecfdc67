"""Jobs: submit, list, read, wait, cancel, retry."""

import hashlib
import shutil
from typing import Annotated, Literal

from anyio import to_thread
from fastapi import APIRouter, Header, Query, Response
from fastapi.responses import PlainTextResponse
from pydantic import Field

from lambent_server import job_queries, removals, render_rows
from lambent_server.clock import now
from lambent_server.database.schema import artifacts
from lambent_server.database.tenancy import Tenant, rows
from lambent_server.estimates import estimate
from lambent_server.job_rows import CANCELLED, FAILED, FINAL, SUCCEEDED, read_events
from lambent_server.messages import (
    Artifact,
    ArtifactList,
    Estimate,
    EventList,
    Job,
    JobKind,
    JobList,
    JobState,
    NewEstimate,
    NewJob,
)
from lambent_server.pagination import PageFilter
from lambent_server.problems import conflict
from lambent_server.routes.common import Id, ServicesOf, TenantOf, problems
from lambent_server.services import Services

router = APIRouter(tags=["jobs"])

IdempotencyKey = Annotated[
    str | None,
    Header(
        alias="Idempotency-Key",
        pattern=r"^[\x21-\x7e]{1,200}$",
        description="The same key with the same body gives the same job for a week.",
    ),
]


class JobFilter(PageFilter):
    """The jobs to list."""

    state: Annotated[list[JobState], Field(max_length=7, default_factory=list)]
    label: Annotated[
        list[Annotated[str, Field(pattern=r"^[A-Za-z0-9._-]{1,63}=[^\x00-\x1f\x7f]{0,200}$")]],
        Field(max_length=8, description='"name=value"; all must hold', default_factory=list),
    ]
    scene: Annotated[str | None, Field(pattern="^[a-z0-9_]{1,64}$", description="Only jobs of it.")] = None
    kind: Annotated[list[JobKind], Field(max_length=6, default_factory=list)]
    q: Annotated[
        str,
        Field(
            max_length=100,
            pattern=r"^[^\x00-\x1f\x7f]*$",
            description="Part of the name of the job's scene, or how its id or its preset's name begins.",
        ),
    ] = ""
    sort: Literal["newest", "oldest"] = "newest"


@router.post("/v1/jobs", status_code=202, responses=problems(400, 404, 409, 413, 422, 429, 507))
def submit_job(services: ServicesOf, tenant: TenantOf, body: NewJob, key: IdempotencyKey = None) -> Job:
    """Queue a job. After the response 202 the job is never lost."""
    services.require_disk()
    digest = hashlib.sha256(body.model_dump_json().encode()).hexdigest()
    with services.database.write() as connection:
        job = job_queries.submit_once(connection, tenant, body, services, key, digest)
        shown = job_queries.show(connection, tenant, job)
    services.wakeups.signal()
    return shown


@router.post("/v1/estimates", responses=problems(400, 403, 413, 422))
def estimate_job(services: ServicesOf, tenant: TenantOf, body: NewEstimate) -> Estimate:
    """Estimate how long a job of a preset will take."""
    preset = job_queries.require_preset(body.preset)
    with services.database.read() as connection:
        return estimate(connection, tenant, preset)


@router.get("/v1/jobs", responses=problems(422))
def list_jobs(services: ServicesOf, tenant: TenantOf, given: Annotated[JobFilter, Query()]) -> JobList:
    """List jobs, newest first unless `sort` says otherwise."""
    labels = [tuple(each.split("=", 1)) for each in given.label]
    with services.database.read() as connection:
        found, cursor = job_queries.select_page(
            connection,
            tenant,
            states=given.state,
            kinds=given.kind,
            labels=labels,
            scene_id=given.scene,
            words=given.q.strip(),
            oldest_first=given.sort == "oldest",
            limit=given.limit,
            cursor=given.cursor,
        )
        items = job_queries.show_all(connection, tenant, found)
    return JobList(items=items, next_cursor=cursor)


def _load(services: Services, tenant: Tenant, job_id: str) -> Job:
    with services.database.read() as connection:
        return job_queries.show(connection, tenant, job_queries.require_job(connection, tenant, job_id))


@router.get("/v1/jobs/{job_id:id}", responses=problems(404, 422))
async def get_job(
    services: ServicesOf,
    tenant: TenantOf,
    job_id: Id,
    wait: Annotated[float, Query(ge=0, le=60, description="Seconds to wait for the job to end.")] = 0.0,
) -> Job:
    """Return a job, at once or as soon as it has ended."""
    deadline = now() + min(wait, services.settings.max_wait_s)
    while True:
        job = await to_thread.run_sync(_load, services, tenant, job_id)
        left = deadline - now()
        if job.state in FINAL or left <= 0 or services.wakeups.closing:
            return job
        await services.wakeups.wait(min(left, services.settings.stream_poll_s))


@router.delete(
    "/v1/jobs/{job_id:id}", status_code=204, response_class=Response, responses=problems(403, 404, 409)
)
def delete_job(services: ServicesOf, tenant: TenantOf, job_id: Id) -> Response:
    """Delete a job that has ended, with its history, artifacts and log; its bundle stays."""
    with services.database.write() as connection:
        removals.delete_job(connection, tenant, job_id)
    shutil.rmtree(services.settings.runs / job_id, ignore_errors=True)
    return Response(status_code=204)


@router.post("/v1/jobs/{job_id:id}:cancel", status_code=202, responses=problems(404, 409))
def cancel_job(services: ServicesOf, tenant: TenantOf, job_id: Id) -> Job:
    """Cancel a job; it is `cancelled` once its process is gone."""
    with services.database.write() as connection:
        job = job_queries.require_job(connection, tenant, job_id, lock=True)
        if job["state"] in (SUCCEEDED, FAILED):
            raise conflict("job_final", f"job {job_id} has {job['state']}; that is final")
        job_queries.cancel(connection, job)
        shown = job_queries.show(connection, tenant, job_queries.require_job(connection, tenant, job_id))
    services.wakeups.signal()
    return shown


@router.post("/v1/jobs/{job_id:id}:retry", status_code=202, responses=problems(404, 409, 429, 507))
def retry_job(services: ServicesOf, tenant: TenantOf, job_id: Id) -> Job:
    """Queue a new job with the request of one that failed or was cancelled; the old one stays unchanged."""
    services.require_disk()
    with services.database.write() as connection:
        job = job_queries.require_job(connection, tenant, job_id)
        if job["state"] not in (FAILED, CANCELLED):
            raise conflict(
                "job_not_ended", f"job {job_id} is {job['state']}; only failed and cancelled jobs can"
            )
        if job["order_id"] is None:
            fresh = job_queries.submit(connection, tenant, job_queries.order_of(job), services)
        else:
            fresh = render_rows.queue_again(connection, tenant, job, services)
        shown = job_queries.show(connection, tenant, fresh)
    services.wakeups.signal()
    return shown


@router.get("/v1/jobs/{job_id:id}/events", responses=problems(404, 422))
def list_events(
    services: ServicesOf,
    tenant: TenantOf,
    job_id: Id,
    after: Annotated[
        int, Query(ge=0, le=2**31 - 1, description="Number of the last event already received.")
    ] = 0,
    limit: Annotated[int, Query(ge=1, le=1000)] = 1000,
) -> EventList:
    """Return the history of a job, in order."""
    with services.database.read() as connection:
        job_queries.require_job(connection, tenant, job_id)
        found = read_events(connection, tenant, job_id, after, limit)
    return EventList(items=[job_queries.show_event(row) for row in found])


@router.get(
    "/v1/jobs/{job_id:id}/log",
    response_class=PlainTextResponse,
    responses={**problems(404, 422), 200: {"content": {"text/plain": {"schema": {"type": "string"}}}}},
)
def get_log(
    services: ServicesOf,
    tenant: TenantOf,
    job_id: Id,
    tail_bytes: Annotated[int, Query(ge=1, le=16 * 1024 * 1024)] = 1024 * 1024,
) -> Response:
    """Return the end of the output of each of a job's run processes."""
    job = _load(services, tenant, job_id)
    parts = []
    for run in range(1, job.run + 1):
        path = services.settings.runs / job.id / f"run-{run}.log"
        if path.exists():
            with path.open("rb") as file:
                file.seek(max(path.stat().st_size - tail_bytes, 0))
                parts.append(f"== run {run} ==\n".encode() + file.read(tail_bytes))
    text = b"\n".join(parts).decode("utf-8", errors="replace")
    return PlainTextResponse(text)


@router.get("/v1/jobs/{job_id:id}/artifacts", responses=problems(404))
def list_artifacts(services: ServicesOf, tenant: TenantOf, job_id: Id) -> ArtifactList:
    """Return the files that a job has produced besides its bundle."""
    with services.database.read() as connection:
        job_queries.require_job(connection, tenant, job_id)
        found = connection.execute(
            rows(tenant, artifacts).where(artifacts.c.job_id == job_id).order_by(artifacts.c.name)
        ).mappings()
        items = [
            Artifact(
                name=row["name"],
                sha256=row["sha256"],
                size_bytes=row["size_bytes"],
                media_type=row["media_type"],
                url=f"/v1/blobs/{row['sha256']}",
            )
            for row in found
        ]
    return ArtifactList(items=items)
