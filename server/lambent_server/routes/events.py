"""One stream of events for any number of jobs (server-sent events)."""

import json
import re
from collections.abc import AsyncIterator
from typing import Annotated, Any

from anyio import to_thread
from fastapi import APIRouter, Header, Query
from fastapi.responses import StreamingResponse
from pydantic import BaseModel, ConfigDict, Field

from lambent_server import job_queries
from lambent_server.clock import now
from lambent_server.database.schema import jobs
from lambent_server.database.tenancy import Tenant, rows
from lambent_server.job_rows import read_events
from lambent_server.metrics import OPEN_STREAMS
from lambent_server.problems import invalid
from lambent_server.routes.common import ServicesOf, TenantOf, problems
from lambent_server.services import Services

router = APIRouter(tags=["events"])

BATCH = 500
# Jobs that a stream without names begins with.
RECENT = 100
_POSITIONS = re.compile(r"[a-z0-9_]{1,64}:\d{1,9}(,[a-z0-9_]{1,64}:\d{1,9})*")

JobId = Annotated[str, Field(pattern="^[a-z0-9_]{1,64}$")]


class StreamFilter(BaseModel):
    """Which jobs to follow; all of the tenant where none is named."""

    model_config = ConfigDict(extra="forbid")

    job: Annotated[list[JobId], Field(max_length=200)] = []


@router.get(
    "/v1/events",
    response_class=StreamingResponse,
    responses={
        **problems(404, 422),
        200: {
            "description": "`snapshot` events carry a job, `event` events one line of its history.",
            "content": {"text/event-stream": {"schema": {"type": "string"}}},
        },
    },
)
async def stream_events(
    services: ServicesOf,
    tenant: TenantOf,
    given: Annotated[StreamFilter, Query()],
    last_event_id: Annotated[
        str | None,
        Header(
            alias="Last-Event-ID", max_length=8000, description='"job_a:12,job_b:3": what is known already'
        ),
    ] = None,
) -> StreamingResponse:
    """Follow jobs: a snapshot of each, then every event, without gaps across reconnections."""
    known = _positions(last_event_id)
    stream = _Stream(services, tenant, tuple(given.job), known)
    # Before the answer begins, so that a wrong name is a 404 and not a broken stream.
    first = await to_thread.run_sync(stream.begin)
    headers = {"cache-control": "no-store", "x-accel-buffering": "no"}
    return StreamingResponse(stream.run(first), media_type="text/event-stream", headers=headers)


def _positions(header: str | None) -> dict[str, int]:
    if not header:
        return {}
    if not _POSITIONS.fullmatch(header):
        raise invalid("last_event_id", "#/header/Last-Event-ID", 'expected "job:number,job:number"')
    pairs = (part.split(":") for part in header.split(","))
    return {job_id: int(seq) for job_id, seq in pairs}


class _Stream:
    """What one client has been told so far."""

    def __init__(
        self, services: Services, tenant: Tenant, names: tuple[str, ...], known: dict[str, int]
    ) -> None:
        self._services = services
        self._tenant = tenant
        self._names = names
        self._known = known
        self._told: dict[str, int] = {}
        self._looked_at = now()

    def begin(self) -> list[str]:
        """Return the snapshots of jobs whose past the client does not know."""
        with self._services.database.read() as connection:
            if self._names:
                found = [job_queries.require_job(connection, self._tenant, name) for name in self._names]
            else:
                found, _ = job_queries.select_page(
                    connection, self._tenant, states=(), labels=(), limit=RECENT, cursor=None
                )
        messages = []
        for job in found:
            if job["id"] in self._known:
                self._told[job["id"]] = min(self._known[job["id"]], job["event_seq"])
            else:
                messages.append(self._snapshot(job))
        return messages

    def _snapshot(self, job: dict[str, Any]) -> str:
        self._told[job["id"]] = job["event_seq"]
        return self._message("snapshot", job_queries.show(job).model_dump())

    def _message(self, event: str, data: dict[str, Any]) -> str:
        identifier = ",".join(f"{job_id}:{seq}" for job_id, seq in self._told.items())
        return f"event: {event}\nid: {identifier}\ndata: {json.dumps(data)}\n\n"

    def news(self) -> list[str]:
        """Return what has happened since the client was told last."""
        messages: list[str] = []
        with self._services.database.read() as connection:
            statement = rows(self._tenant, jobs, jobs.c.id, jobs.c.event_seq)
            if self._names:
                statement = statement.where(jobs.c.id.in_(self._names))
            else:
                # Two clocks may disagree a little where there are two servers.
                statement = statement.where(jobs.c.updated_at > self._looked_at - 10)
            looked_at = now()
            for job_id, seq in connection.execute(statement.order_by(jobs.c.id)).all():
                if job_id not in self._told:
                    messages.append(self._snapshot(job_queries.require_job(connection, self._tenant, job_id)))
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
        """Yield messages until the client goes or the server ends."""
        settings, wakeups = self._services.settings, self._services.wakeups
        sent_at = now()
        with OPEN_STREAMS.track_inprogress():
            yield ": hello\n\n" + "".join(first)
            while not wakeups.closing:
                messages = await to_thread.run_sync(self.news)
                if messages:
                    yield "".join(messages)
                    sent_at = now()
                elif now() - sent_at >= settings.stream_ping_s:
                    yield ": ping\n\n"
                    sent_at = now()
                await wakeups.wait(min(settings.stream_poll_s, settings.stream_ping_s))
