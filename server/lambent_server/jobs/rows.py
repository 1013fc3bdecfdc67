"""Database rows of jobs and their history; the only module that changes a job's state."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from sqlalchemy import ColumnElement, Connection, FromClause, and_, insert, literal_column, or_

from lambent_server.accounts.usage import add_gpu_time
from lambent_server.core.clock import now
from lambent_server.database.engine import announce
from lambent_server.database.model import EventRow, JobRow
from lambent_server.database.rows import many
from lambent_server.database.schema import events, jobs
from lambent_server.database.tenancy import Tenant, change, rows
from lambent_server.jobs.checkpoints import drop_checkpoints
from lambent_server.webhooks.outbox import tell

QUEUED = "queued"
RUNNING = "running"
CANCELLING = "cancelling"
RETRY_WAIT = "retry_wait"
SUCCEEDED = "succeeded"
FAILED = "failed"
CANCELLED = "cancelled"
FINAL = frozenset({SUCCEEDED, FAILED, CANCELLED})
UNFINISHED = (QUEUED, RUNNING, CANCELLING, RETRY_WAIT)
HAS_RUN = frozenset({RUNNING, CANCELLING})
ENDED = "ended"
"""The reason to stop of a cancelled job whose run has said that it ends."""


@dataclass(frozen=True, kw_only=True, slots=True)
class NewEvent:
    """An event of a job's history without its number."""

    type: str
    run: int = 0
    state: str = ""
    progress: dict[str, Any] | None = None
    message: str = ""
    sha256: str = ""
    name: str = ""


def in_state(*states: str, table: FromClause = jobs) -> ColumnElement[bool]:
    """Return the condition that a job is in one of these states, written as the conditions of indexes are."""
    literals: list[ColumnElement[str]] = [literal_column(f"'{state}'") for state in states]
    return table.c.state.in_(literals) if len(states) > 1 else table.c.state == literals[0]


def is_unfinished(table: FromClause = jobs) -> ColumnElement[bool]:
    """Return the condition that a job has not ended."""
    return in_state(*UNFINISHED, table=table)


def is_observed() -> ColumnElement[bool]:
    """Return the condition that a job has a run or a process, which the index of observed jobs serves."""
    return or_(in_state(RUNNING, CANCELLING), jobs.c.handle.is_not(None))


def is_startable(table: FromClause = jobs) -> ColumnElement[bool]:
    """Return the condition that a job is queued and has no process, which the index of the queue serves."""
    return and_(in_state(QUEUED, table=table), table.c.handle.is_(None))


def owner(job: JobRow) -> Tenant:
    """Return the tenant of the job."""
    return Tenant(job.tenant_id)


def append_event(connection: Connection, job: JobRow, event: NewEvent) -> int:
    """Append an event to the job's history and return its number; numbers have no gaps."""
    return append_events(connection, job, [event])


def append_events(connection: Connection, job: JobRow, new: Sequence[NewEvent]) -> int:
    """Append events to the job's history, in two statements however many they are.

    Returns the number of the last one.
    """
    statement = (
        change(owner(job), jobs)
        .where(jobs.c.id == job.id)
        .values(event_seq=jobs.c.event_seq + len(new), updated_at=now())
        .returning(jobs.c.event_seq)
    )
    last: int = connection.execute(statement).scalar_one()
    if not new:
        return last
    first, tenant = last - len(new) + 1, owner(job)
    values = [
        {
            "tenant_id": tenant.id,
            "job_id": job.id,
            "seq": seq,
            "at": now(),
            "type": event.type,
            "run": event.run or job.run,
            "state": event.state,
            "progress": event.progress,
            "message": event.message,
            "sha256": event.sha256,
            "name": event.name,
        }
        for seq, event in enumerate(new, first)
    ]
    connection.execute(insert(events), values)
    announce(connection)
    return last


def set_fields(connection: Connection, job: JobRow, **values: Any) -> None:
    """Update columns of the job."""
    connection.execute(change(owner(job), jobs).where(jobs.c.id == job.id).values(updated_at=now(), **values))


def move(connection: Connection, job: JobRow, state: str, message: str = "", **values: Any) -> bool:
    """Change the job's state and record it; return False if its state has been changed meanwhile."""
    if state in FINAL:
        values |= {"finished_at": now(), "retry_at": None}
    # The state and the run that the caller saw are the claim on the job: of two servers that start it, or of
    # one that starts and one that cancels it, the first changes the row, the other finds nothing to change.
    statement = (
        change(owner(job), jobs)
        .where(jobs.c.id == job.id, jobs.c.state == job.state, jobs.c.run == job.run)
        .values(state=state, updated_at=now(), **values)
        .returning(jobs.c.gpus, jobs.c.run_started_at)
    )
    moved = connection.execute(statement).first()
    if moved is None:
        return False
    if moved.gpus and job.state in HAS_RUN and state not in HAS_RUN:
        # From the row, not from `job`: the run may have started after the caller looked.
        add_gpu_time(connection, owner(job), moved.gpus, moved.run_started_at, now())
    if state in FINAL:
        drop_checkpoints(connection, owner(job), job.id)
    event = NewEvent(type="state", state=state, message=message, run=values.get("run") or job.run)
    seq = append_event(connection, job, event)
    tell(connection, replace(job, **values), state, seq)
    return True


def read_events(
    connection: Connection, tenant: Tenant, job_id: str, after: int, limit: int
) -> list[EventRow]:
    """Return up to `limit` events of the history after number `after`."""
    statement = (
        rows(tenant, events)
        .where(events.c.job_id == job_id, events.c.seq > after)
        .order_by(events.c.seq)
        .limit(limit)
    )
    return many(connection, statement, EventRow)
