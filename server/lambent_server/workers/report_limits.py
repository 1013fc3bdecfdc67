"""Limits of what a run may report: it is untrusted code, and what it sends is written to the database."""

from google.protobuf.message import Message
from lambent_proto.v1 import worker_pb2
from sqlalchemy import Connection

from lambent_server.core.clock import now
from lambent_server.core.settings import Settings
from lambent_server.database.model import JobRow
from lambent_server.jobs.outcomes import Failure, fail
from lambent_server.jobs.rows import CANCELLING, HAS_RUN

CODE = "run_reports_too_much"
MAX_EVENTS = 250
"""Events of one report. Our own runs send 200 at most."""
MAX_REPORT_BYTES = 1024 * 1024
MAX_PROGRESS_BYTES = 4096
EVENTS_AT_ONCE = 20_000
"""Events that a job may have at its start."""
EVENTS_PER_S = 5.0
"""Further events per second since then."""
MAX_CHECKPOINT_FILES = 1000
MAX_PUBLISHED_FILES = 10_000


def excess(request: Message | None, job: JobRow) -> str:
    """Return what of a request is too much and how much is allowed; "" if nothing is."""
    if isinstance(request, worker_pb2.ReportRequest):
        return _excess_of_report(request, job)
    if isinstance(request, worker_pb2.CommitCheckpointRequest):
        return _above("files of a checkpoint", len(request.manifest.files), MAX_CHECKPOINT_FILES) or _history(
            job, 1
        )
    if isinstance(request, worker_pb2.PublishRequest):
        count = len(request.bundle_files) + len(request.artifacts)
        return _above("files of a result", count, MAX_PUBLISHED_FILES)
    return ""


def _excess_of_report(request: worker_pb2.ReportRequest, job: JobRow) -> str:
    return (
        _above("events in one report", len(request.events), MAX_EVENTS)
        or _above("bytes in one report", request.ByteSize(), MAX_REPORT_BYTES)
        or _above("bytes of progress in one report", request.progress.ByteSize(), MAX_PROGRESS_BYTES)
        or _history(job, len(request.events))
    )


def _history(job: JobRow, more: int) -> str:
    age_s = max(now() - (job.started_at or now()), 0.0)
    allowed = int(EVENTS_AT_ONCE + EVENTS_PER_S * age_s)
    return _above(f"events in the history of a job of {age_s:.0f} s", job.event_seq + more, allowed)


def _above(what: str, count: int, limit: int) -> str:
    return f"{count} {what}, {limit} are allowed" if count > limit else ""


def end(connection: Connection, job: JobRow, why: str, settings: Settings) -> None:
    """Let the run fail that has reported too much; one that has to end anyway just ends."""
    if job.state in HAS_RUN and job.state != CANCELLING and job.stop_reason is None:
        message = f"the run has reported too much ({why}); see its log for what it was doing"
        fail(connection, job, Failure("internal", CODE, message), settings)
