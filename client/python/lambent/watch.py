"""Following jobs: a stream of events that survives lost connections, or polling where streams do not pass."""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import httpx2

from lambent.connection import Connection
from lambent.errors import LambentError, ServerFaultError, UnreachableError
from lambent.models import FINAL_STATES, Event, Job

SILENCE_S = 45.0
"""A stream without a byte for this long is dead: the server sends a comment every 15 s."""

PATIENCE_S = 600.0
"""How long a server may be unavailable before watching gives up."""

POLL_S = 1.0


@dataclass(kw_only=True)
class Watcher:
    """One watch over some jobs; iterate it once.

    Yields a `Job` for every job first, then `Event`s in order and without repeats, and a final `Job` for
    every job. Ends when all are in a final state. A lost connection is taken up again where it broke
    (Last-Event-ID); after two streams that were silent or no event streams at all it polls instead.
    """

    connection: Connection
    job_ids: Sequence[str]
    after: Mapping[str, int] | None
    silence_s: float
    patience_s: float
    poll_s: float
    sleep: Callable[[float], None]
    clock: Callable[[], float]

    def __post_init__(self) -> None:
        self._open = dict.fromkeys(self.job_ids)
        self._seen = dict(self.after or {})
        self._num_mute_streams = 0

    def __iter__(self) -> Iterator[Event | Job]:
        """Yield jobs and events until every job is final; raise `UnreachableError` when patience ends."""
        for job_id in list(self._open):
            yield from self._settle(job_id)
        last_contact = self.clock()
        pause_s = 0.25
        while self._open:
            follow = self._polled if self._num_mute_streams >= 2 else self._streamed
            try:
                for update in follow():
                    last_contact, pause_s = self.clock(), 0.25
                    yield update
                    if isinstance(update, Event) and update.state in FINAL_STATES:
                        yield from self._settle(update.job_id, only_final=True)
                    if not self._open:
                        return
                # A stream that ended in peace (a server shutting down does that) counts as contact.
                for job_id in list(self._open):
                    yield from self._settle(job_id, only_final=True)
                last_contact = self.clock()
            except (UnreachableError, ServerFaultError):
                if self.clock() - last_contact > self.patience_s:
                    raise
            if self._open:
                self.sleep(pause_s)
                pause_s = min(pause_s * 2.0, 5.0)

    def _settle(self, job_id: str, only_final: bool = False) -> Iterator[Job]:
        """Ask for the job itself, which alone says whether it is final."""
        job = Job.from_json(self.connection.json("GET", f"/v1/jobs/{job_id}"))
        # Where nothing was seen yet, events are reported from now on.
        self._seen.setdefault(job_id, job.last_event)
        if job.is_final:
            self._open.pop(job_id, None)
        if job.is_final or not only_final:
            yield job

    def _fresh(self, event: Event) -> bool:
        if event.job_id not in self._open or event.seq <= self._seen.get(event.job_id, 0):
            return False
        self._seen[event.job_id] = event.seq
        return True

    def _streamed(self) -> Iterator[Event]:
        headers = {"Accept": "text/event-stream", "Cache-Control": "no-cache"}
        known = {job_id: seq for job_id, seq in self._seen.items() if job_id in self._open}
        if known:
            headers["Last-Event-ID"] = ",".join(f"{job_id}:{seq}" for job_id, seq in known.items())
        params = [("job", job_id) for job_id in self._open]
        heard = False
        try:
            with self.connection.stream(
                "/v1/events", headers=headers, params=params, timeout_s=self.silence_s
            ) as response:
                for message in httpx2.EventSource(response):
                    heard = True
                    self._num_mute_streams = 0
                    event = _event_of(message.data)
                    if event is not None and self._fresh(event):
                        yield event
        except UnreachableError as error:
            # Nothing came through, or something else than a stream: a proxy that holds answers back or
            # replaces them. A refused connection is different: that server will come back.
            if not heard and isinstance(error.__cause__, httpx2.ReadTimeout | httpx2.SSEError):
                self._num_mute_streams += 1
            raise

    def _polled(self) -> Iterator[Event]:
        for job_id in list(self._open):
            after = self._seen.get(job_id, 0)
            answer = self.connection.json("GET", f"/v1/jobs/{job_id}/events", params={"after": after})
            for item in answer["items"]:
                event = Event.from_json(item)
                if self._fresh(event):
                    yield event
        self.sleep(self.poll_s)


def _event_of(data: str) -> Event | None:
    """Return the event in an SSE message, or None for a snapshot or something newer than this client."""
    if not data:
        return None
    try:
        decoded: Any = json.loads(data)
    except ValueError as error:
        raise LambentError(
            "client.unexpected_answer",
            f"the event stream holds {data[:60]!r}, which is not JSON",
            "check that LAMBENT_URL points at a Lambent server",
        ) from error
    if isinstance(decoded, dict) and "job_id" in decoded and "seq" in decoded:
        return Event.from_json(decoded)
    return None
