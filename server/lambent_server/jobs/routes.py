"""Jobs: submit, list, read, wait, cancel, retry."""

import hashlib
import shutil
import time
from typing import Annotated, Literal

from anyio import to_thread
from fastapi import APIRouter, Query, Request, Response
from fastapi.responses import PlainTextResponse
from pydantic import Field

from lambent_server.accounts import audit
from lambent_server.api.change_messages import JobChange
from lambent_server.api.messages import (
    Artifact,
    ArtifactList,
    Estimate,
    Event,
    EventList,
    Job,
    JobKind,
    JobList,
    JobState,
    NewEstimate,
    NewJob,
)
from lambent_server.api.pagination import FilePageFilter, LabelFilter, LongPageFilter, select_ordered
from lambent_server.api.problems import conflict
from lambent_server.api.resources import IdempotencyKey, IfMatch, ResourceRoute, require_match
from lambent_server.database.model import ArtifactRow, EventRow
from lambent_server.database.schema import artifacts, events
from lambent_server.database.tenancy import Tenant, rows
from lambent_server.http.common import Id, ServicesOf, TenantOf, WhoOf, problems, require_key
from lambent_server.jobs import logs as run_logs
from lambent_server.jobs import queries as job_queries
from lambent_server.jobs import removals
from lambent_server.jobs.estimates import estimate
from lambent_server.jobs.feed import Feed, Subscription
from lambent_server.jobs.pages import Wanted
from lambent_server.jobs.rows import FAILED, FINAL, SUCCEEDED
from lambent_server.services import Services
from lambent_server.storage.store import blob_url

router = APIRouter(tags=["jobs"], route_class=ResourceRoute)


class JobFilter(LabelFilter):
    """The jobs to list."""

    state: Annotated[list[JobState], Field(max_length=7, default_factory=list)]
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


class EventFilter(LongPageFilter):
    """The events to list."""

    after: Annotated[
        int, Field(ge=0, le=2**31 - 1, description="Number of the last event already received.")
    ] = 0


@router.post("/v1/jobs", status_code=202, responses=problems(400, 404, 409, 413, 422, 429, 507))
def submit_job(
    services: ServicesOf,
    tenant: TenantOf,
    who: WhoOf,
    request: Request,
    body: NewJob,
    key: IdempotencyKey = None,
) -> Job:
    """Queue a job. After the response 202 the job is never lost."""
    services.require_disk()
    if body.webhook is not None:
        # It outlasts the session of the browser, as a subscription does.
        require_key(request, "a webhook of a job")
    # As before there were webhooks: keys hold across an upgrade.
    unset = {"webhook"} if body.webhook is None else set()
    digest = hashlib.sha256(body.model_dump_json(exclude=unset).encode()).hexdigest()
    with services.database.write() as connection:
        job = job_queries.submit_once(connection, tenant, body, services, key, digest, who.maker)
        shown = job_queries.show(connection, tenant, job)
        audit.record(connection, who, "submit_job", shown.id)
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
    with services.database.read() as connection:
        wanted = Wanted(
            states=given.state,
            kinds=given.kind,
            labels=[tuple(each.split("=", 1)) for each in given.label],
            scene_id=given.scene,
            words=given.q.strip(),
        )
        oldest_first = given.sort == "oldest"
        page, cursor = job_queries.select_page(connection, tenant, wanted, given, oldest_first=oldest_first)
        items = job_queries.show_all(connection, tenant, page)
    return JobList(items=items, next_cursor=cursor)


def _load(services: Services, tenant: Tenant, job_id: str) -> Job:
    with services.database.read() as connection:
        return job_queries.show(connection, tenant, job_queries.require_job(connection, tenant, job_id))


@router.get("/v1/jobs/{job_id:id}", responses=problems(404, 422))
async def get_job(
    services: ServicesOf,
    tenant: TenantOf,
    request: Request,
    job_id: Id,
    wait: Annotated[float, Query(ge=0, le=60, description="Seconds to wait for the job to end.")] = 0.0,
) -> Job:
    """Return a job, at once or as soon as it has ended."""
    if not wait:
        return await to_thread.run_sync(_load, services, tenant, job_id)
    deadline = time.monotonic() + min(wait, services.settings.max_wait_s)
    feed: Feed = request.app.state.feed
    told: dict[str, int] = {}
    subscription = Subscription(frozenset({job_id}), told)
    with feed.subscribed(tenant, subscription):
        await feed.begin()
        while True:
            subscription.take()
            job = await to_thread.run_sync(_load, services, tenant, job_id)
            told[job_id] = job.last_event
            left = deadline - time.monotonic()
            if job.state in FINAL or left <= 0 or services.wakeups.closing:
                return job
            await subscription.wait(left)


@router.patch("/v1/jobs/{job_id:id}", responses=problems(400, 403, 404, 409, 412, 413, 422))
def change_job(
    services: ServicesOf, tenant: TenantOf, who: WhoOf, job_id: Id, body: JobChange, if_match: IfMatch = None
) -> Job:
    """Change the labels of a job, or the priority of one that waits."""
    with audit.recorded(services.database, who, "change_job", job_id) as connection:
        job = job_queries.require_job(connection, tenant, job_id, lock=True)
        require_match(if_match, job_queries.show(connection, tenant, job))
        job_queries.change_job(connection, tenant, job, body, services.settings)
        shown = job_queries.show(connection, tenant, job_queries.require_job(connection, tenant, job_id))
    services.wakeups.signal()
    return shown


@router.delete(
    "/v1/jobs/{job_id:id}", status_code=204, response_class=Response, responses=problems(403, 404, 409)
)
def delete_job(services: ServicesOf, tenant: TenantOf, who: WhoOf, job_id: Id) -> None:
    """Delete a job that has ended, with its history, artifacts and log; its bundle stays."""
    with audit.recorded(services.database, who, "delete_job", job_id) as connection:
        removals.delete_job(connection, tenant, job_id)
    shutil.rmtree(services.settings.runs / job_id, ignore_errors=True)


@router.post("/v1/jobs/{job_id:id}:cancel", status_code=202, responses=problems(404, 409))
def cancel_job(services: ServicesOf, tenant: TenantOf, who: WhoOf, job_id: Id) -> Job:
    """Cancel a job; it is `cancelled` once its process is gone."""
    with audit.recorded(services.database, who, "cancel_job", job_id) as connection:
        job = job_queries.require_job(connection, tenant, job_id, lock=True)
        if job.state in (SUCCEEDED, FAILED):
            raise conflict("job_final", f"job {job_id} has {job.state}; that is final")
        job_queries.cancel(connection, job)
        shown = job_queries.show(connection, tenant, job_queries.require_job(connection, tenant, job_id))
    services.wakeups.signal()
    return shown


@router.get("/v1/jobs/{job_id:id}/events", responses=problems(404, 422))
def list_events(
    services: ServicesOf,
    tenant: TenantOf,
    job_id: Id,
    given: Annotated[EventFilter, Query()],
) -> EventList:
    """Return the history of a job, in order."""
    with services.database.read() as connection:
        job_queries.require_job(connection, tenant, job_id)
        page, cursor = select_ordered(
            connection,
            EventRow,
            rows(tenant, events).where(events.c.job_id == job_id, events.c.seq > given.after),
            [events.c.seq],
            page=given,
        )
    return EventList(items=[Event.of(row) for row in page], next_cursor=cursor)


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
        log = run_logs.tail(services, tenant, job.id, run, tail_bytes)
        if log is not None:
            parts.append(f"== run {run} ==\n".encode() + log)
    text = b"\n".join(parts).decode("utf-8", errors="replace")
    return PlainTextResponse(text)


@router.get("/v1/jobs/{job_id:id}/artifacts", responses=problems(404, 422))
def list_artifacts(
    services: ServicesOf, tenant: TenantOf, job_id: Id, given: Annotated[FilePageFilter, Query()]
) -> ArtifactList:
    """Return the files that a job has produced besides its bundle, by name."""
    with services.database.read() as connection:
        job_queries.require_job(connection, tenant, job_id)
        page, cursor = select_ordered(
            connection,
            ArtifactRow,
            rows(tenant, artifacts).where(artifacts.c.job_id == job_id),
            [artifacts.c.name],
            page=given,
        )
    return ArtifactList(
        items=[Artifact.of(row, url=blob_url(row.sha256)) for row in page], next_cursor=cursor
    )
