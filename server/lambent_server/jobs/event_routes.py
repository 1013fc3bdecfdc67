"""One stream of events for any number of jobs (server-sent events)."""

import random
import re
import time
from collections.abc import AsyncIterator, Sequence
from contextlib import ExitStack
from typing import Annotated

import structlog
from anyio import to_thread
from fastapi import APIRouter, Header, Query, Request
from fastapi.responses import StreamingResponse
from pydantic import BaseModel, ConfigDict, Field
from sqlalchemy import Connection, func, tuple_
from sqlalchemy.exc import SQLAlchemyError
from starlette.types import Receive, Scope, Send

from lambent_server.accounts.scopes import READ
from lambent_server.api.messages import Event
from lambent_server.api.problems import invalid, not_found
from lambent_server.api.resources import ResourceRoute
from lambent_server.core.clock import now
from lambent_server.core.metrics import OPEN_STREAMS
from lambent_server.database.model import JobRow
from lambent_server.database.rows import many
from lambent_server.database.schema import events, jobs
from lambent_server.database.tenancy import Tenant, rows
from lambent_server.http.common import ServicesOf, TenantOf, problems
from lambent_server.http.rechecks import Identify
from lambent_server.jobs import queries as job_queries
from lambent_server.jobs.feed import BATCH, WINDOW_S, Change, Feed, Shown, Subscription, encode
from lambent_server.jobs.rows import read_events
from lambent_server.services import Services

log = structlog.get_logger()

router = APIRouter(tags=["events"], route_class=ResourceRoute)

MAX_JOBS = 1024
# Jobs whose last event a stream of all jobs remembers, and those that its ids name, in every message.
REMEMBERED = 200
NAMED = 50
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
        **problems(404, 422, 429, 503),
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
    identify: Identify = request.state.identify
    stream = _Stream(
        services, request.app.state.feed, tenant, frozenset(given.job), _positions(last_event_id), identify
    )
    # Before the response begins, so that an unknown job is a 404 and not a broken stream.
    return _Events(stream, await stream.begin())


def _positions(header: str | None) -> dict[str, int]:
    if not header:
        return {}
    if not _POSITIONS.fullmatch(header):
        raise invalid("last_event_id", "#/header/Last-Event-ID", 'expected "job:number,job:number"')
    pairs = (part.split(":") for part in header.split(","))
    return {job_id: int(seq) for job_id, seq in pairs}


class _Stream:
    """One client's stream, with what it has been sent so far."""

    def __init__(
        self,
        services: Services,
        feed: Feed,
        tenant: Tenant,
        names: frozenset[str],
        known: dict[str, int],
        identify: Identify,
    ) -> None:
        self._services = services
        self._identify = identify
        self._feed = feed
        self._tenant = tenant
        self._names = names
        # Those that changed last are at the end.
        self._known = known if names else dict(list(known.items())[-REMEMBERED:])
        self._told: dict[str, int] = {}
        self._positions: dict[str, str] = {}
        self._complete_at = now()
        self._subscription = Subscription(names, self._told)
        self._open = ExitStack()

    def close(self) -> None:
        """Leave the feed."""
        self._open.close()

    async def begin(self) -> list[str]:
        """Return snapshots of the jobs whose history the client does not have, and the news of the others."""
        with ExitStack() as stack:
            stack.enter_context(self._feed.subscribed(self._tenant, self._subscription))
            await self._feed.begin()
            self._complete_at = now()
            first: list[str] = []
            if self._names or self._known:
                first = await to_thread.run_sync(self._read_first, limiter=self._feed.limiter)
            if not self._names:
                recent = await self._feed.recent(self._tenant)
                first += self._snapshots([each for each in recent if each.job_id not in self._told])
            self._open = stack.pop_all()
        return first

    def _read_first(self) -> list[str]:
        """Return snapshots of the named jobs, and the events of those that the client knows."""
        with self._services.database.read() as connection:
            unknown = self._names - set(self._known)
            statement = rows(self._tenant, jobs).where(jobs.c.id.in_(sorted(unknown)))
            unseen = many(connection, statement, JobRow) if unknown else []
            known = self._names & set(self._known) if self._names else frozenset(self._known)
            statement = rows(self._tenant, jobs, jobs.c.id, jobs.c.event_seq)
            numbered = connection.execute(statement.where(jobs.c.id.in_(sorted(known))))
            seqs = {job.id: job.event_seq for job in numbered}
            if missing := self._names - {job.id for job in unseen} - set(seqs):
                raise not_found("job", min(missing))
            # First, so that every message says where the client is in all of them.
            for job_id, seq in seqs.items():
                self._tell(job_id, min(self._known[job_id], seq))
            messages = self._snapshots(
                [
                    Shown(job.id, job.last_event, encode(job))
                    for job in job_queries.show_all(connection, self._tenant, unseen)
                ]
            )
            for job_id, seq in seqs.items():
                messages += self._read_job(connection, job_id, seq)
            if not self._names:
                self._complete_at = self._time_of_last(connection)
        # A stream of all jobs may have missed others than those that its ids name.
        return messages if self._names else messages + self._read()

    def _time_of_last(self, connection: Connection) -> float:
        """Return the time of the last event that the client has; now if it has none that exist."""
        pairs = tuple_(events.c.job_id, events.c.seq).in_(list(self._known.items()))
        at: float | None = connection.execute(
            rows(self._tenant, events, func.max(events.c.at)).where(pairs)
        ).scalar()
        return now() if at is None else at

    def _snapshots(self, shown: Sequence[Shown]) -> list[str]:
        """Return snapshot messages; only the last one says where the client is, which is long."""
        for each in shown[:-1]:
            self._tell(each.job_id, each.seq)
        messages = [f"event: snapshot\ndata: {each.data}\n\n" for each in shown[:-1]]
        return messages + [self._message("snapshot", each.job_id, each.seq, each.data) for each in shown[-1:]]

    def _tell(self, job_id: str, seq: int) -> None:
        """Note that the client has the events of a job up to `seq`."""
        # The jobs that changed last come last, and are the last to be forgotten.
        self._told.pop(job_id, None)
        self._positions.pop(job_id, None)
        self._told[job_id] = seq
        self._positions[job_id] = f"{job_id}:{seq}"
        if not self._names and len(self._told) > REMEMBERED:
            del self._told[next(iter(self._told))]
        if not self._names and len(self._positions) > NAMED:
            del self._positions[next(iter(self._positions))]

    def _message(self, event: str, job_id: str, seq: int, data: str) -> str:
        self._tell(job_id, seq)
        return f"event: {event}\nid: {','.join(self._positions.values())}\ndata: {data}\n\n"

    async def _news(self) -> list[str]:
        """Return the messages for everything that was offered since the last ones."""
        offered_at = self._feed.offered_at
        changes = self._subscription.take()
        messages: list[str] = []
        if changes is None or not all(self._add(change, messages) for change in changes):
            return messages + await to_thread.run_sync(self._read, limiter=self._feed.limiter)
        self._complete_at = max(self._complete_at, offered_at)
        return messages

    def _add(self, change: Change, messages: list[str]) -> bool:
        """Add the messages of a change; return False if there are events before it that the client lacks."""
        told = self._told.get(change.job_id)
        if told is None:
            if change.snapshot is None:
                return False
            messages += self._snapshots([change.snapshot])
            return True
        if told < change.start:
            return False
        messages += [
            self._message("event", change.job_id, seq, data) for seq, data in change.events if seq > told
        ]
        return True

    def _read(self) -> list[str]:
        """Return the messages for everything that the client does not have, from the database."""
        messages: list[str] = []
        with self._services.database.read() as connection:
            statement = rows(self._tenant, jobs, jobs.c.id, jobs.c.event_seq)
            if self._names:
                statement = statement.where(jobs.c.id.in_(self._names))
            else:
                statement = statement.where(jobs.c.updated_at > self._complete_at - WINDOW_S)
            looked_at = now()
            for job_id, seq in connection.execute(statement.order_by(jobs.c.id)).all():
                if job_id not in self._told:
                    row = job_queries.require_job(connection, self._tenant, job_id)
                    job = job_queries.show(connection, self._tenant, row)
                    messages += self._snapshots([Shown(job_id, job.last_event, encode(job))])
                messages += self._read_job(connection, job_id, seq)
            self._complete_at = looked_at
        return messages

    def _read_job(self, connection: Connection, job_id: str, seq: int) -> list[str]:
        """Return the messages for the events of one job up to `seq`."""
        messages: list[str] = []
        while self._told[job_id] < seq:
            history = read_events(connection, self._tenant, job_id, self._told[job_id], BATCH)
            if not history:
                break
            messages += [self._message("event", job_id, row.seq, encode(Event.of(row))) for row in history]
        return messages

    def _may_go_on(self) -> bool:
        """Return whether the key or session of the client is still valid, and may read this organisation."""
        try:
            who = self._identify()
        except SQLAlchemyError as error:
            # Without the database there is no news to withhold.
            log.warning("stream_not_checked", error=type(error).__name__)
            return True
        return who is not None and who.tenant == self._tenant and READ in who.scopes

    async def run(self, first: list[str]) -> AsyncIterator[str]:
        """Yield messages until the client disconnects, loses its access or the server stops."""
        wakeups, ping_s = self._services.wakeups, self._services.settings.stream_ping_s
        # So that streams that began together do not send their pings together.
        next_ping = time.monotonic() + random.uniform(0.5, 1.0) * ping_s  # noqa: S311
        # As seldom as pings, also where there is always news.
        next_check = next_ping
        OPEN_STREAMS.inc()
        try:
            yield ": hello\n\n" + "".join(first)
            # Tens of kilobytes that would stay as long as the stream.
            first.clear()
            while not wakeups.closing:
                await self._subscription.wait(max(min(next_ping, next_check) - time.monotonic(), 0.0))
                if time.monotonic() >= next_check:
                    if not await to_thread.run_sync(self._may_go_on, limiter=self._feed.limiter):
                        break
                    next_check = time.monotonic() + ping_s
                messages = await self._news()
                if messages:
                    yield "".join(messages)
                elif time.monotonic() >= next_ping:
                    yield ": ping\n\n"
                else:
                    continue
                next_ping = time.monotonic() + ping_s
        finally:
            OPEN_STREAMS.dec()


class _Events(StreamingResponse):
    """The response of a stream, which ends with it, however it ends."""

    def __init__(self, stream: _Stream, first: list[str]) -> None:
        headers = {"cache-control": "no-store", "x-accel-buffering": "no"}
        super().__init__(stream.run(first), media_type="text/event-stream", headers=headers)
        self._stream = stream

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send the stream."""
        try:
            await super().__call__(scope, receive, send)
        finally:
            self._stream.close()
