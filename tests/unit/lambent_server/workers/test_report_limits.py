"""A run that reports too much fails, and neither it nor its reports keep others from writing."""

import contextlib
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import grpc
import pytest
from lambent_proto.v1 import worker_pb2
from lambent_server.database.schema import events, jobs
from lambent_server.database.tenancy import change
from lambent_server.workers import gate as worker_gate
from lambent_server.workers import report_limits
from lambent_server.workers.gate import Shares
from sqlalchemy import func, select
from support.api import STRANGER_KEY, TENANT, expect
from support.databases import postgresql
from support.runs import Stage, metadata, refused, staged

LOG = {"type": "log", "message": "x" * 40}


@pytest.fixture(params=["sqlite", pytest.param("postgresql", marks=pytest.mark.services)])
def stage(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Stage]:
    with contextlib.ExitStack() as stack:
        given: dict[str, Any] = {"max_failures": 1}
        if request.param == "postgresql":
            given["database"] = stack.enter_context(postgresql())
        yield stack.enter_context(staged(tmp_path, **given))


def num_events(stage: Stage, job_id: str) -> int:
    with stage.api.services.database.read() as connection:
        return connection.execute(select(func.count()).where(events.c.job_id == job_id)).scalar_one()


def failed(stage: Stage, job_id: str) -> str:
    """Return the message of a job that has failed because its run reported too much."""
    job = stage.job(job_id)
    assert (job["state"], job["error"]["code"]) == ("failed", "run_reports_too_much")
    return str(job["error"]["message"])


def test_a_report_of_twenty_thousand_events_ends_the_run_and_stores_none_of_them(stage: Stage):
    job = stage.start()
    before = num_events(stage, job)
    began = time.monotonic()
    with refused(grpc.StatusCode.INVALID_ARGUMENT):
        stage.call("Report", job, sequence=1, events=[LOG] * 20_000)
    assert time.monotonic() - began < 2.0
    # That it has failed is all there is to tell.
    assert num_events(stage, job) == before + 1
    assert "20000 events in one report, 250 are allowed" in failed(stage, job)
    with refused(grpc.StatusCode.FAILED_PRECONDITION):
        stage.call("Heartbeat", job)


@pytest.mark.parametrize(
    ("report", "what"),
    [
        ({"events": [{"type": "log", "message": "x" * 30_000}] * 40}, "bytes in one report"),
        ({"progress": {"stage": "x" * 5000}}, "bytes of progress"),
    ],
)
def test_a_report_of_too_many_bytes_ends_the_run(stage: Stage, report: dict[str, Any], what: str):
    job = stage.start()
    with refused(grpc.StatusCode.INVALID_ARGUMENT):
        stage.call("Report", job, sequence=1, **report)
    assert what in failed(stage, job)


def test_a_full_report_is_stored_in_order_and_quickly(stage: Stage):
    job = stage.start()
    messages = [f"line {number}" for number in range(report_limits.MAX_EVENTS)]
    took = []
    for sequence in range(1, 4):
        began = time.monotonic()
        stage.call(
            "Report", job, sequence=sequence, events=[{"type": "log", "message": each} for each in messages]
        )
        took.append(time.monotonic() - began)
    with stage.api.services.database.read() as connection:
        statement = select(events.c.seq, events.c.message).where(
            events.c.job_id == job, events.c.type == "log"
        )
        found = connection.execute(statement.order_by(events.c.seq)).all()
    assert [message for _, message in found] == 3 * messages
    assert [seq for seq, _ in found] == list(range(found[0].seq, found[0].seq + 3 * len(messages)))
    # Most of it is the call, outside of the transaction.
    assert min(took) < 0.5


def test_a_history_has_a_number_of_events_that_grows_with_time(stage: Stage, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(report_limits, "EVENTS_AT_ONCE", 100)
    job = stage.start()
    stage.call("Report", job, sequence=1, events=[LOG] * 90)
    with stage.api.services.database.write() as connection:
        mine = change(TENANT, jobs).where(jobs.c.id == job)
        connection.execute(mine.values(started_at=jobs.c.started_at - 60.0))
    stage.call("Report", job, sequence=2, events=[LOG] * 250)
    with refused(grpc.StatusCode.INVALID_ARGUMENT):
        stage.call("Report", job, sequence=3, events=[LOG] * 90)
    assert "events in the history of a job of 60 s" in failed(stage, job)


def test_long_messages_are_cut_and_say_so(stage: Stage):
    job = stage.start()
    stage.call("Report", job, sequence=1, events=[{"type": "log", "message": "y" * 9000, "name": "n" * 400}])
    found = expect(stage.api.get(f"/v1/jobs/{job}/events"), 200)["items"][-1]
    assert found["message"] == "y" * 8000 + "… (1000 more characters)"
    assert found["name"] == "n" * 300 + "… (100 more characters)"


@pytest.mark.parametrize("method", ["CommitCheckpoint", "Publish"])
def test_a_checkpoint_or_a_result_of_too_many_files_ends_the_run(stage: Stage, method: str):
    job = stage.start()
    file = {"path": "a", "sha256": "0" * 64, "size_bytes": 1.0}
    if method == "Publish":
        given: dict[str, Any] = {"artifacts": [file] * 10_001}
    else:
        given = {"manifest": {"stage": "cache", "step": 1, "files": [file] * 1001}}
    with refused(grpc.StatusCode.INVALID_ARGUMENT):
        stage.call(method, job, **given)
    assert "are allowed" in failed(stage, job)


def test_a_result_of_many_files_is_published_at_once(stage: Stage):
    job = stage.start()
    digest = stage.put(job, b"picture")
    files = [{"path": f"{number}.png", "sha256": digest, "size_bytes": 7.0} for number in range(2000)]
    began = time.monotonic()
    stage.call("Publish", job, artifacts=files)
    assert time.monotonic() - began < 5.0
    assert stage.job(job)["state"] == "succeeded"
    assert len(expect(stage.api.get(f"/v1/jobs/{job}/artifacts?limit=1000"), 200)["items"]) == 1000


def test_a_job_that_is_being_cancelled_does_not_fail_for_what_it_reports(stage: Stage):
    job = stage.start()
    expect(stage.api.post(f"/v1/jobs/{job}:cancel"), 202)
    with refused(grpc.StatusCode.INVALID_ARGUMENT):
        stage.call("Report", job, sequence=1, events=[LOG] * 251)
    assert stage.job(job)["state"] == "cancelling"


def test_a_run_whose_transactions_take_too_long_waits_but_its_heartbeats_do_not(
    monkeypatch: pytest.MonkeyPatch,
):
    at = [100.0]
    monkeypatch.setattr(worker_gate.time, "monotonic", lambda: at[0])
    shares = Shares(calls=10, calls_per_s=100.0)

    def call(run: str, seconds: float, *, beats: bool = False) -> str:
        reason = shares.enter(run, stream=False, beats=beats)
        if not reason:
            with shares.timed(*run.split(".")) as begin:
                # Time before it has the lock is that of others.
                at[0] += 5.0
                begin()
                at[0] += seconds
            shares.leave(run, stream=False)
        return reason

    assert call("job.1", 30.0) == ""
    assert call("job.1", 0.0) == "transactions"
    assert call("job.1", 0.0, beats=True) == ""
    assert call("other.1", 1.0) == ""
    at[0] += 40.0
    assert call("job.1", 0.0) == ""


def test_another_tenant_writes_while_a_run_reports_as_much_as_it_may(stage: Stage):
    job = stage.start()
    other = stage.api.other(STRANGER_KEY)
    slowest = 0.0
    for sequence in range(1, 9):
        pending = stage.stub.Report.future(
            worker_pb2.ReportRequest(
                fence={"job_id": job, "run": 1}, sequence=sequence, events=[LOG] * report_limits.MAX_EVENTS
            ),
            metadata=metadata(job, 1, None),
        )
        began = time.monotonic()
        expect(other.post("/v1/scenes", json={"name": "x"}), 201)
        slowest = max(slowest, time.monotonic() - began)
        pending.result(timeout=10)
    assert slowest < 1.0
