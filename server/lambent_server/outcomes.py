"""What becomes of a job when its run ends: done, tried again by cause, or given up."""

from dataclasses import dataclass
from typing import Any

from sqlalchemy import Connection

from lambent_server.clock import now
from lambent_server.job_rows import CANCELLED, FAILED, QUEUED, RETRY_WAIT, SUCCEEDED, Job, move
from lambent_server.metrics import RUNS_FAILED, RUNS_LOST
from lambent_server.settings import Settings


@dataclass(frozen=True, slots=True)
class Failure:
    """Why a run did not end well; `cause` is the lower-case name of a FailCause."""

    cause: str
    code: str
    message: str


# Causes that another try cannot mend.
_HOPELESS = frozenset({"bad_scene", "bad_config"})
# Causes that each stage is tried with once more, with something changed: the setting and its factor.
_ADJUSTED = {"gpu_out_of_memory": ("ray_chunk", 0.5), "diverged": ("learning_rate", 0.3)}


def _error(failure: Failure, job: Job) -> dict[str, Any]:
    return {
        "code": failure.code,
        "message": failure.message,
        "cause": failure.cause,
        "run": job["run"],
    }


def succeed(connection: Connection, job: Job, **values: Any) -> bool:
    """End the job well."""
    return move(connection, job, SUCCEEDED, error=None, **values)


def settle_cancel(connection: Connection, job: Job) -> bool:
    """End a job whose cancellation was asked for, now that no process of it is left."""
    return move(connection, job, CANCELLED, "cancelled", stop_reason=None)


def requeue(connection: Connection, job: Job, message: str, **values: Any) -> bool:
    """Let the job start again at once; it is not the job's fault."""
    return move(connection, job, QUEUED, message, stop_reason=None, **values)


def adjustments_of(job: Job) -> dict[str, dict[str, float]]:
    """Return what the job's failures have changed: factors by setting, by the stage they are for."""
    kept = dict(job["adjustments"])
    # Rows of the version before have the factors of one stage beside its name.
    stage = kept.pop("stage", None)
    return kept if stage is None else {stage: kept}


def fail(connection: Connection, job: Job, failure: Failure, settings: Settings) -> bool:
    """Try the job again after a failure of its own, or give it up; a cancelled job just ends."""
    RUNS_FAILED.labels(failure.cause).inc()
    failures = job["failures"] + 1
    adjustments = adjustments_of(job)
    give_up = failure.cause in _HOPELESS or failures >= settings.max_failures
    if failure.cause in _ADJUSTED:
        name, factor = _ADJUSTED[failure.cause]
        stage = (job["progress"] or {}).get("stage", "")
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
        f"{failure.code}: {failure.message}; next try in {delay:g} s",
        retry_at=now() + delay,
        adjustments=adjustments,
        **common,
    )


def lose(connection: Connection, job: Job, how: str, settings: Settings) -> bool:
    """Start a job again whose machine or process vanished, unless that happens too often."""
    RUNS_LOST.inc()
    losses = job["losses"] + 1
    barren = job["losses_without_checkpoint"] + 1
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
