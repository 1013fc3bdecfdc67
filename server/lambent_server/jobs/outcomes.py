"""The outcome of a job when its run ends: done, retried depending on the cause, or failed."""

from dataclasses import dataclass
from typing import Any

import structlog
from sqlalchemy import ColumnElement, Connection, or_

from lambent_server.core.clock import JUMP_S, now
from lambent_server.core.metrics import RUNS_FAILED, RUNS_LOST
from lambent_server.core.settings import Settings
from lambent_server.database.model import JobRow
from lambent_server.database.schema import jobs
from lambent_server.executors import Gone
from lambent_server.jobs.rows import (
    CANCELLED,
    CANCELLING,
    FAILED,
    QUEUED,
    RETRY_WAIT,
    RUNNING,
    SUCCEEDED,
    move,
    set_fields,
)

log = structlog.get_logger()


@dataclass(frozen=True, slots=True)
class Failure:
    """The reason why a run failed; `cause` is the lower-case name of a FailCause."""

    cause: str
    code: str
    message: str


# Causes that a retry cannot fix.
_HOPELESS = frozenset({"bad_scene", "bad_config"})
# Causes that are retried once per stage with an adjustment: the setting and its factor.
_ADJUSTED = {"gpu_out_of_memory": ("ray_chunk", 0.5), "diverged": ("learning_rate", 0.3)}


def _error(failure: Failure, job: JobRow) -> dict[str, Any]:
    return {
        "code": failure.code,
        "message": failure.message,
        "cause": failure.cause,
        "run": job.run,
    }


def succeed(connection: Connection, job: JobRow, **values: Any) -> bool:
    """Complete the job successfully."""
    return move(connection, job, SUCCEEDED, error=None, **values)


def settle_cancel(connection: Connection, job: JobRow) -> bool:
    """Complete the cancellation of a job that has no process any more."""
    return move(connection, job, CANCELLED, "cancelled", stop_reason=None)


def requeue(connection: Connection, job: JobRow, message: str, **values: Any) -> bool:
    """Queue the job to restart at once, without counting a failure."""
    return move(connection, job, QUEUED, message, stop_reason=None, **values)


def fail(connection: Connection, job: JobRow, failure: Failure, settings: Settings) -> bool:
    """Retry the job after a failure of its own, or fail it; a job being cancelled just ends."""
    RUNS_FAILED.labels(failure.cause).inc()
    failures = job.failures + 1
    # By stage, factors by setting.
    adjustments: dict[str, dict[str, float]] = dict(job.adjustments)
    give_up = failure.cause in _HOPELESS or failures >= settings.max_failures
    if failure.cause in _ADJUSTED:
        name, factor = _ADJUSTED[failure.cause]
        stage = (job.progress or {}).get("stage", "")
        own = adjustments.get(stage, {})
        give_up = give_up or name in own
        adjustments |= {stage: own | {name: factor}}
    common: dict[str, Any] = {"error": _error(failure, job), "failures": failures, "stop_reason": None}
    if give_up:
        return move(connection, job, FAILED, failure.message, **common)
    delay = settings.retry_delay_s * 2 ** (failures - 1)
    return move(
        connection,
        job,
        RETRY_WAIT,
        f"{failure.code}: {failure.message}; retrying in {delay:g} s",
        retry_at=now() + delay,
        adjustments=adjustments,
        **common,
    )


def wait_for_room(connection: Connection, job: JobRow, why: str, settings: Settings) -> bool:
    """Send a job back to the queue that could not be placed, after a pause and without counting anything."""
    wait_s = settings.place_retry_s
    message = f"not placed: {why}; back in the queue in {wait_s:g} s"
    return move(connection, job, RETRY_WAIT, message, stop_reason=None, retry_at=now() + wait_s)


def is_due(settings: Settings, at: float) -> ColumnElement[bool]:
    """Return the condition that a waiting job starts again at the time `at` (Unix seconds).

    A time that is further away than any wait comes from a clock that has been set back since.
    """
    longest_s = max(settings.retry_delay_s * 2.0 ** max(settings.max_failures - 2, 0), settings.place_retry_s)
    return or_(jobs.c.retry_at <= at, jobs.c.retry_at > at + longest_s + JUMP_S)


def lose(connection: Connection, job: JobRow, how: str, settings: Settings) -> bool:
    """Restart a job whose machine or process was lost, unless that has happened too often."""
    RUNS_LOST.inc()
    losses = job.losses + 1
    barren = job.losses_without_checkpoint + 1
    common: dict[str, Any] = {"losses": losses, "losses_without_checkpoint": barren}
    if losses > settings.max_losses:
        failure = Failure("lost", "run_lost", f"lost {losses} runs, the last because {how}")
    elif barren >= settings.max_losses_without_checkpoint:
        failure = Failure(
            "lost", "run_poisoned", f"lost {barren} runs in a row before a checkpoint, the last because {how}"
        )
    else:
        return requeue(connection, job, f"lost: {how}", **common)
    return move(
        connection, job, FAILED, failure.message, error=_error(failure, job), stop_reason=None, **common
    )


def judge(connection: Connection, job: JobRow, gone: Gone, settings: Settings) -> bool:
    """Move on the job of a run that has ended without saying how; return whether anything changed."""
    set_fields(connection, job, handle=None)
    if job.state == CANCELLING:
        return settle_cancel(connection, job)
    if job.state != RUNNING:
        return True
    if gone.not_placed:
        return wait_for_room(connection, job, gone.not_placed, settings)
    if job.stop_reason == "stall":
        message = "no step was done for too long; see the log"
        return fail(connection, job, Failure("stalled", "run_stalled", message), settings)
    if gone.exit_code is not None and gone.exit_code > 0:
        message = f"the run process ended with code {gone.exit_code}; see the log"
        return fail(connection, job, Failure("internal", "run_crashed", message), settings)
    how = "the process is gone" if not gone.exit_code else f"signal {-gone.exit_code}"
    log.warning("run_lost", job=job.id, run=job.run, how=how)
    return lose(connection, job, how, settings)
