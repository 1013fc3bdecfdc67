"""One stream of events for any number of jobs (server-sent events)."""

import asyncio
import json
import re
from collections import Counter
from collections.abc import AsyncIterator
from typing import Annotated, Any

from anyio import CapacityLimiter, to_thread
from fastapi import APIRouter, Header, Query, Request
from fastapi.responses import StreamingResponse
from pydantic import BaseModel, ConfigDict, Field

from lambent_server import job_queries
from lambent_server.clock import now
from lambent_server.database.schema import jobs
from lambent_server.database.tenancy import Tenant, across_tenants, rows
from lambent_server.job_rows import read_events
from lambent_server.messages import Job
from lambent_server.metrics import OPEN_STREAMS
from lambent_server.problems import Problem, invalid
from lambent_server.routes.common import ServicesOf, TenantOf, problems
from lambent_server.services import Services

router = APIRouter(tags=["events"])

BATCH = 500
MAX_JOBS = 1024
# Threads that read for streams; the other threads serve requests.
READERS = 4
# If there are two servers, their clocks may differ slightly.
CLOCKS_S = 10.0
# Changes kept for all streams; a stream that was delayed for longer queries the database itself.
WINDOW_S = 60.0
# Jobs with which a stream that names none begins.
RECENT = 100
_POSITIONS = re.compile(r"[a-z0-9_]{1,64}:\d{1,9}(,[a-z0-9_]{1,64}:\d{1,9})*")

JobId = Annotated[str, Field(pattern="^[a-z0-9_]{1,64}$")]


class StreamFilter(BaseModel):
    """The jobs to follow; all jobs of the tenant if none is named."""

    model_config = ConfigDict(extra="forbid")

    job: Annotated[list[JobId], Field(max_length=MAX_JOBS)] = []


@router.get(
    "/v1/events",
    response_class=StreamingResponse,
    responses={
        **problems(404, 422, 429),
        200: {
            "description": "`snapshot` events carry a job, `event` events an event of its history.",
            "content": {"text/event-stream": {"schema": {"type": "string"}}},
        },
    },
)
async def stream_events(
    services: ServicesOf,
    tenant: TenantOf,
    request: Request,
    given: Annotated[StreamFilter, Query()],
    last_event_id: Annotated[
        str | None,
        Header(
            alias="Last-Event-ID", max_length=60_000, description='"job_a:12,job_b:3": last events received'
        ),
    ] = None,
) -> StreamingResponse:
    """Follow jobs: a snapshot of each, then every event, without gaps across reconnections."""
    known = _positions(last_event_id)
    feed: Feed = request.app.state.feed
    feed.require_room(tenant)
    stream = _Stream(services, feed, tenant, frozenset(given.job), known)
    # Before the response begins, so that an unknown job is a 404 and not a broken stream.
    first = await to_thread.run_sync(stream.begin, limiter=feed.limiter)
    headers = {"cache-control": "no-store", "x-accel-buffering": "no"}
    return StreamingResponse(stream.run(first), media_type="text/event-stream", headers=headers)


def _positions(header: str | None) -> dict[str, int]:
    if not header:
        return {}
    if not _POSITIONS.fullmatch(header):
        raise invalid("last_event_id", "#/header/Last-Event-ID", 'expected "job:number,job:number"')
    pairs = (part.split(":") for part in header.split(","))
    return {job_id: int(seq) for job_id, seq in pairs}


class Feed:
    """Recent changes, read once for all streams, so that an idle stream does not query the database."""

    def __init__(self, services: Services) -> None:
        self._services = services
        self._lock = asyncio.Lock()
        self._last: dict[str, dict[str, int]] = {}
        self.limiter = CapacityLimiter(READERS)
        self.looked_at = 0.0
        self.num_open: Counter[str] = Counter()

    def require_room(self, tenant: Tenant) -> None:
        """Refuse a stream beyond the quota."""
        limit = self._services.settings.max_streams
        if self.num_open[tenant.id] >= limit:
            raise Problem(
                429,
                "quota_streams",
                f"{limit} event streams are open, which is the limit; one stream can follow many jobs",
                retryable=True,
                headers={"retry-after": "5"},
                members={"quota": {"name": "max_streams", "limit": limit, "used": limit}},
            )

    async def changes(self, tenant: Tenant, not_before: float) -> dict[str, int]:
        """Return the last event of each recently changed job, as of `not_before` or later."""
        async with self._lock:
            if self.looked_at < not_before:
                await to_thread.run_sync(self._look, limiter=self.limiter)
        return self._last.get(tenant.id, {})

    def _look(self) -> None:
        at = now()
        last: dict[str, dict[str, int]] = {}
        with self._services.database.read() as connection:
            statement = across_tenants(jobs, jobs.c.tenant_id, jobs.c.id, jobs.c.event_seq)
            for tenant_id, job_id, seq in connection.execute(
                statement.where(jobs.c.updated_at > at - WINDOW_S)
            ):
                last.setdefault(tenant_id, {})[job_id] = seq
        self._last, self.looked_at = last, at


class _Stream:
    """One client's stream, with what it has been sent so far."""

    def __init__(
        self, services: Services, feed: Feed, tenant: Tenant, names: frozenset[str], known: dict[str, int]
    ) -> None:
        self._services = services
        self._feed = feed
        self._tenant = tenant
        self._names = names
        self._known = known
        self._told: dict[str, int] = {}
        self._looked_at = now()

    def begin(self) -> list[str]:
        """Return snapshots of the jobs whose history the client does not have."""
        with self._services.database.read() as connection:
            if self._names:
                found = [
                    job_queries.require_job(connection, self._tenant, name) for name in sorted(self._names)
                ]
            else:
                found, _ = job_queries.select_page(connection, self._tenant, limit=RECENT, cursor=None)
            unknown = [job for job in found if job["id"] not in self._known]
            shown = {job.id: job for job in job_queries.show_all(connection, self._tenant, unknown)}
        messages = []
        for job in found:
            if job["id"] in self._known:
                self._told[job["id"]] = min(self._known[job["id"]], job["event_seq"])
            else:
                messages.append(self._snapshot(shown[job["id"]]))
        return messages

    def _snapshot(self, job: Job) -> str:
        self._told[job.id] = job.last_event
        return self._message("snapshot", job.model_dump())

    def _message(self, event: str, data: dict[str, Any]) -> str:
        identifier = ",".join(f"{job_id}:{seq}" for job_id, seq in self._told.items())
        return f"event: {event}\nid: {identifier}\ndata: {json.dumps(data)}\n\n"

    async def _news(self, *, signalled: bool) -> list[str]:
        """Return the messages for everything that happened since the last ones."""
        age_s = 0.0 if signalled else self._services.settings.stream_poll_s / 2
        changes = await self._feed.changes(self._tenant, now() - age_s)
        looked_at = self._feed.looked_at
        known = all(
            self._told.get(job_id, -1) >= seq
            for job_id, seq in changes.items()
            if not self._names or job_id in self._names
        )
        if known and self._looked_at - CLOCKS_S >= looked_at - WINDOW_S:
            self._looked_at = looked_at
            return []
        return await to_thread.run_sync(self._read, limiter=self._feed.limiter)

    def _read(self) -> list[str]:
        messages: list[str] = []
        with self._services.database.read() as connection:
            statement = rows(self._tenant, jobs, jobs.c.id, jobs.c.event_seq)
            if self._names:
                statement = statement.where(jobs.c.id.in_(self._names))
            else:
                statement = statement.where(jobs.c.updated_at > self._looked_at - CLOCKS_S)
            looked_at = now()
            for job_id, seq in connection.execute(statement.order_by(jobs.c.id)).all():
                if job_id not in self._told:
                    job = job_queries.require_job(connection, self._tenant, job_id)
                    messages.append(self._snapshot(job_queries.show(connection, self._tenant, job)))
                while self._told[job_id] < seq:
                    found = read_events(connection, self._tenant, job_id, self._told[job_id], BATCH)
                    if not found:
                        break
                    for row in found:
                        self._told[job_id] = row["seq"]
                        messages.append(self._message("event", job_queries.show_event(row).model_dump()))
            self._looked_at = looked_at
        return messages

    async def run(self, first: list[str]) -> AsyncIterator[str]:
        """Yield messages until the client disconnects or the server stops."""
        settings, wakeups = self._services.settings, self._services.wakeups
        sent_at, signalled, num_open = now(), True, self._feed.num_open
        num_open[self._tenant.id] += 1
        OPEN_STREAMS.inc()
        try:
            yield ": hello\n\n" + "".join(first)
            while not wakeups.closing:
                messages = await self._news(signalled=signalled)
                if messages:
                    yield "".join(messages)
                    sent_at = now()
                elif now() - sent_at >= settings.stream_ping_s:
                    yield ": ping\n\n"
                    sent_at = now()
                signalled = await wakeups.wait(min(settings.stream_poll_s, settings.stream_ping_s))
        finally:
            num_open[self._tenant.id] -= 1
            OPEN_STREAMS.dec()
