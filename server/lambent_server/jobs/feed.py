"""The news of all jobs: read from the database once per process, and handed to every stream in memory."""

import asyncio
import json
import time
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass

import structlog
from anyio import CapacityLimiter, to_thread
from pydantic import BaseModel
from sqlalchemy import Connection
from sqlalchemy.exc import SQLAlchemyError

from lambent_server.api.messages import Event
from lambent_server.api.pagination import PageFilter
from lambent_server.api.problems import Problem
from lambent_server.core.clock import now
from lambent_server.database.schema import jobs
from lambent_server.database.tenancy import Tenant, across_tenants
from lambent_server.http.budget import Budget
from lambent_server.jobs import queries as job_queries
from lambent_server.jobs.pages import Wanted
from lambent_server.jobs.rows import read_events
from lambent_server.services import Services

log = structlog.get_logger()

BATCH = 500
# Threads that read for single streams: at their beginning, and where one was too slow for the feed.
READERS = 4
# Jobs that were changed in this time are compared: transactions take time, and clocks of servers differ.
WINDOW_S = 60.0
# Jobs with which a stream that names none begins, and the longest time for which they are kept.
RECENT = 100
RECENT_S = 1.0
# Shortest time between two looks, so that events close together are sent together.
PAUSE_S = 0.05
# Streams that are woken together, and the pause after them, for other requests and threads.
SLICE = 20
SLICE_PAUSE_S = 0.002
# Time that a new request is given to be answered before more streams are woken.
GIVE_WAY_S = 0.05
# Time for the first look.
BEGIN_S = 10.0
# Changes that wait for one stream; a stream that falls further behind reads the database itself.
MAX_WAITING = 256


@dataclass(frozen=True, slots=True)
class Shown:
    """A job as JSON, and the number of its last event."""

    job_id: str
    seq: int
    data: str


@dataclass(frozen=True, slots=True)
class Change:
    """What happened to one job: its events after number `start`, each as JSON."""

    job_id: str
    start: int
    events: tuple[tuple[int, str], ...]
    snapshot: Shown | None
    """The job, if some stream has never seen it."""

    @property
    def last(self) -> int:
        """Return the number of the last event."""
        return self.events[-1][0] if self.events else self.start


class Subscription:
    """The changes that one stream has not sent yet, shared with all other streams."""

    def __init__(self, names: frozenset[str], told: Mapping[str, int]) -> None:
        """Follow `names`, or every job if it is empty; `told` has the last event sent of each job."""
        self.names = names
        self.told = told
        self._waiting: deque[Change] = deque()
        self._woken = asyncio.Event()
        self._behind = False

    def follows(self, job_id: str) -> bool:
        """Return whether the stream is about this job."""
        return not self.names or job_id in self.names

    def offer(self, changes: Iterable[Change]) -> None:
        """Add changes; beyond the limit all are dropped, because the database has them too."""
        for change in changes:
            if self.follows(change.job_id):
                self._waiting.append(change)
                self._woken.set()
        if len(self._waiting) > MAX_WAITING:
            self._waiting.clear()
            self._behind = True

    def take(self) -> list[Change] | None:
        """Return the changes that wait, or None if the stream has to read the database."""
        self._woken.clear()
        changes, self._waiting = list(self._waiting), deque()
        behind, self._behind = self._behind, False
        return None if behind else changes

    async def wait(self, timeout_s: float) -> None:
        """Wait for changes, at most `timeout_s`."""
        try:
            async with asyncio.timeout(timeout_s):
                await self._woken.wait()
        except TimeoutError:
            return

    def wake(self) -> None:
        """End the wait."""
        self._woken.set()


class Feed:
    """Reads while there are streams: at every signal, and once per polling interval without one."""

    def __init__(self, services: Services, budget: Budget) -> None:
        self._services = services
        self._budget = budget
        self._streams: dict[str, set[Subscription]] = {}
        self._reader: asyncio.Task[None] | None = None
        self._signalled = asyncio.Event()
        self._begun = asyncio.Event()
        self._published: dict[str, int] = {}
        self._looked_at = 0.0
        self._recent: dict[str, tuple[float, list[Shown]]] = {}
        self._recent_lock = asyncio.Lock()
        self._offers = 0
        self._own = CapacityLimiter(1)
        self.limiter = CapacityLimiter(READERS)
        self.offered_at = 0.0
        """Time up to which every stream was offered what had happened."""
        services.wakeups.listen(self._on_signal)

    @contextmanager
    def subscribed(self, tenant: Tenant, subscription: Subscription) -> Iterator[None]:
        """Hand changes to `subscription` inside the `with` block."""
        streams = self._streams.setdefault(tenant.id, set())
        streams.add(subscription)
        loop = asyncio.get_running_loop()
        if self._reader is None or self._reader.done() or self._reader.get_loop() is not loop:
            self._begun, self._signalled = asyncio.Event(), asyncio.Event()
            self._recent_lock = asyncio.Lock()
            self._reader = loop.create_task(self._read_on())
        try:
            yield
        finally:
            streams.discard(subscription)
            if not streams and self._streams.get(tenant.id) is streams:
                del self._streams[tenant.id]

    async def begin(self) -> None:
        """Wait until the feed reads; whatever is committed after this will be offered.

        Raises the problem if the database does not answer.
        """
        try:
            async with asyncio.timeout(BEGIN_S):
                await self._begun.wait()
        except TimeoutError as error:
            detail = "the database does not answer"
            raise Problem(503, "database_unavailable", detail, retryable=True) from error

    async def recent(self, tenant: Tenant) -> list[Shown]:
        """Return the newest jobs for a stream that has begun, read once for all that begin with it.

        Whatever is missing in them will be offered, because an offer makes what was read before it obsolete.
        """
        async with self._recent_lock:
            at, shown = self._recent.get(tenant.id, (float("-inf"), []))
            if time.monotonic() - at < RECENT_S:
                return shown
            offers, at = self._offers, time.monotonic()
            shown = await to_thread.run_sync(self._read_recent, tenant, limiter=self.limiter)
            if self._offers == offers:
                self._recent[tenant.id] = (at, shown)
            return shown

    def _read_recent(self, tenant: Tenant) -> list[Shown]:
        with self._services.database.read() as connection:
            newest, _ = job_queries.select_page(connection, tenant, Wanted(), PageFilter(limit=RECENT))
            shown = job_queries.show_all(connection, tenant, newest)
        return [Shown(job.id, job.last_event, encode(job)) for job in shown]

    def _on_signal(self) -> None:
        reader = self._reader
        if reader is not None and not reader.done() and not reader.get_loop().is_closed():
            reader.get_loop().call_soon_threadsafe(self._signalled.set)

    async def _read_on(self) -> None:
        """Read and offer until there are no streams, or the server stops."""
        loop, wakeups = asyncio.get_running_loop(), self._services.wakeups
        self._looked_at, baseline = now(), True
        while self._streams:
            began = loop.time()
            self._signalled.clear()
            streams = {tenant_id: tuple(own) for tenant_id, own in self._streams.items()}
            try:
                look = await to_thread.run_sync(self._look, streams, baseline, limiter=self._own)
            except (SQLAlchemyError, OSError) as error:
                log.warning("feed_failed", error=type(error).__name__)
            else:
                self._published, self._looked_at = look.published, look.at
                if baseline or look.advanced:
                    # Streams that begin now will not be offered what was found, whoever was.
                    self._recent, self._offers = {}, self._offers + 1
                baseline = False
                self._begun.set()
                await self._offer(look.changes)
                self.offered_at = look.at
            if wakeups.closing:
                break
            # At most half of the time, however many streams there are.
            await asyncio.sleep(max(PAUSE_S, loop.time() - began))
            with suppress(TimeoutError):
                async with asyncio.timeout(self._services.settings.stream_poll_s):
                    await self._signalled.wait()
        for subscription in [each for streams in self._streams.values() for each in streams]:
            subscription.wake()

    async def _offer(self, changes: Mapping[str, Sequence[Change]]) -> None:
        for tenant_id, news in changes.items():
            for number, subscription in enumerate(tuple(self._streams.get(tenant_id, ())), start=1):
                subscription.offer(news)
                if number % SLICE == 0:
                    await self._give_way()

    async def _give_way(self) -> None:
        """Let other requests be answered first: streams may wait, who submits a job should not."""
        ends = time.monotonic() + GIVE_WAY_S
        await asyncio.sleep(SLICE_PAUSE_S)
        while self._budget.requested_within(GIVE_WAY_S) and time.monotonic() < ends:
            await asyncio.sleep(SLICE_PAUSE_S)

    def _look(self, streams: Mapping[str, Sequence[Subscription]], baseline: bool) -> "_Look":
        """Return what is new since the last look, for tenants with streams; nothing for a `baseline`."""
        at = now()
        changes: dict[str, list[Change]] = {}
        published: dict[str, int] = {}
        advanced = False
        with self._services.database.read() as connection:
            statement = across_tenants(jobs, jobs.c.tenant_id, jobs.c.id, jobs.c.event_seq)
            recent = statement.where(jobs.c.updated_at > self._looked_at - WINDOW_S)
            for tenant_id, job_id, seq in connection.execute(recent).all():
                published[job_id] = seq
                before = self._published.get(job_id)
                advanced = advanced or before != seq
                if baseline or before == seq or tenant_id not in streams:
                    continue
                change = _read(connection, Tenant(tenant_id), job_id, seq, before, streams[tenant_id])
                if change is not None:
                    published[job_id] = max(change.last, seq)
                    changes.setdefault(tenant_id, []).append(change)
        return _Look(at, published, advanced, changes)


@dataclass(frozen=True, slots=True)
class _Look:
    """What one look at the database found."""

    at: float
    published: dict[str, int]
    advanced: bool
    changes: dict[str, list[Change]]


def _read(
    connection: Connection,
    tenant: Tenant,
    job_id: str,
    seq: int,
    before: int | None,
    streams: Sequence[Subscription],
) -> Change | None:
    """Return the events of a job after number `before`, or after what its streams have, if it has streams."""
    told = [stream.told.get(job_id) for stream in streams if stream.follows(job_id)]
    if not told:
        return None
    known = [number for number in told if number is not None]
    start = before if before is not None and known else min(known, default=seq)
    events: list[tuple[int, str]] = []
    while (events[-1][0] if events else start) < seq:
        history = read_events(connection, tenant, job_id, events[-1][0] if events else start, BATCH)
        if not history:
            break
        events += [(row.seq, encode(Event.of(row))) for row in history]
    snapshot = None
    if len(known) < len(told):
        job = job_queries.show(connection, tenant, job_queries.require_job(connection, tenant, job_id))
        snapshot = Shown(job_id, job.last_event, encode(job))
    return Change(job_id, start, tuple(events), snapshot)


def encode(message: BaseModel) -> str:
    """Return the data of a message."""
    return json.dumps(message.model_dump())
