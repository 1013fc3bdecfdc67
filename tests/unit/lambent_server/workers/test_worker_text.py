"""Texts and numbers of run processes: what is refused, what is cleaned, and what every call refuses."""

import math
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import grpc
import pytest
from lambent_proto.v1 import worker_pb2
from lambent_server.api.problems import Problem
from lambent_server.workers.text import admit
from support.databases import postgresql
from support.runs import Stage, metadata, refused, staged

INVALID = grpc.StatusCode.INVALID_ARGUMENT
FILE = {"path": "a", "sha256": "0" * 64}
CALLS: dict[str, tuple[str, dict[str, Any]]] = {
    "a report's event": ("Report", {"sequence": 1, "events": [{"type": "log\0"}]}),
    "a preview's hash": ("Report", {"sequence": 1, "events": [{"type": "preview", "sha256": "\0"}]}),
    "a report's number": ("Report", {"sequence": 2**32 - 1}),
    "a stage": ("Report", {"sequence": 1, "progress": {"stage": "\0"}}),
    "a layout": ("ReportScene", {"report": {"layout": "\0"}}),
    "a finding": ("ReportScene", {"report": {"findings": [{"code": "\0"}]}}),
    "a page": ("ReportScene", {"page_sha256": "\0"}),
    "a thumbnail": ("ReportScene", {"thumbnail_sha256": "x"}),
    "a figure": ("ReportScene", {"figures": {"gap_deg": math.nan}}),
    "a located blob": ("LocateBlob", {"sha256": "\0"}),
    "a planned upload": ("PlanUpload", {"sha256": "0" * 64, "size_bytes": math.inf}),
    "a checkpoint's stage": ("CommitCheckpoint", {"manifest": {"stage": "\0"}}),
    "a checkpoint's step": ("CommitCheckpoint", {"manifest": {"step": 2**31}}),
    "a checkpoint's file": ("CommitCheckpoint", {"manifest": {"files": [{**FILE, "path": "\0"}]}}),
    "a size": ("Publish", {"artifacts": [{**FILE, "size_bytes": math.nan}]}),
    "a media type": ("Publish", {"artifacts": [{**FILE, "media_type": "text/html\r\nset-cookie: a=b"}]}),
    "a media type of a bundle": ("Publish", {"bundle_files": [{**FILE, "media_type": "html"}]}),
    "a path": ("Publish", {"artifacts": [{**FILE, "path": "a\0"}]}),
    "a code": ("Fail", {"code": "a\0", "message": "x"}),
    "a process": ("Register", {"process_identity": "\0"}),
    "a version": ("Start", {"code_version": "\0"}),
    "a complete upload": ("CompleteUpload", {"sha256": "0" * 64, "media_type": "a/b\r\nx: y"}),
}


@pytest.fixture(scope="module", params=["sqlite", "postgresql"])
def stage(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stage]:
    with ExitStack() as stack:
        given = {"database": stack.enter_context(postgresql())} if request.param == "postgresql" else {}
        folder: Path = tmp_path_factory.mktemp(request.param)
        yield stack.enter_context(staged(folder, local_slots=2, **given))


@pytest.fixture(scope="module")
def job(stage: Stage) -> str:
    return stage.start()


@pytest.mark.parametrize("name", CALLS)
def test_no_call_gets_through_with(stage: Stage, job: str, name: str):
    method, fields = CALLS[name]
    with refused(INVALID):
        stage.call(method, job, **fields)
    assert stage.job(job)["state"] == "running"


def put(stage: Stage, job: str, *messages: dict[str, Any]) -> None:
    """Send these messages as a blob."""
    given = iter([worker_pb2.PutBlobRequest(**each) for each in messages])
    stage.stub.PutBlob(given, metadata=metadata(job, 1, None), timeout=5)


def test_a_stream_is_checked_too(stage: Stage, job: str):
    head = {"fence": {"job_id": job, "run": 1}, "sha256": "0" * 64, "size_bytes": 1.0}
    for wrong in ({"media_type": "a/b\r\nx: y"}, {"sha256": "\0"}, {"size_bytes": math.nan}):
        with refused(INVALID):
            put(stage, job, {"header": {**head, **wrong}}, {"data": b"x"})
    with refused(INVALID):
        put(stage, job, {"data": b"x"})
    with refused(INVALID):
        put(stage, job)
    request = worker_pb2.GetBlobRequest(fence=head["fence"], sha256="\0")
    with refused(INVALID):
        list(stage.stub.GetBlob(request, metadata=metadata(job, 1, None), timeout=5))


def test_free_text_loses_its_nul_and_a_loss_that_overflowed_is_not_known(stage: Stage, job: str):
    progress = {
        "stage": "joint",
        "step": 1,
        "num_steps": 2,
        "loss": math.inf,
        "psnr": math.nan,
        "doing": "a\0b",
    }
    events = [{"type": "log", "message": "one\0 two", "name": "a\0"}]
    stage.call("Report", job, sequence=1, progress=progress, events=events)
    shown = stage.job(job)["progress"]
    assert (shown["loss"], shown["psnr"], shown["doing"]) == (0.0, 0.0, "ab")
    stored = stage.api.get(f"/v1/jobs/{job}/events").json()["items"]
    assert [each["message"] for each in stored if each["type"] == "log"] == ["one two"]


def test_what_a_run_sends_otherwise_is_admitted_as_it_is():
    request = worker_pb2.PublishRequest(
        fence={"job_id": "job_x", "run": 1},
        artifacts=[{"path": "ä/b.png", "sha256": "0" * 64, "size_bytes": 1e12, "media_type": "image/png"}],
    )
    before = request.SerializeToString(deterministic=True)
    admit(request)
    assert request.SerializeToString(deterministic=True) == before


def test_a_problem_names_the_field():
    request = worker_pb2.PublishRequest(artifacts=[{"path": "a", "media_type": "x"}])
    with pytest.raises(Problem) as caught:
        admit(request)
    assert caught.value.errors[0].pointer == "#/artifacts/media_type"
