"""Runs send files to a real S3 server, and fetch them there, without the API in between."""

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import grpc
import httpx2
import pytest
from lambent_proto.v1 import worker_pb2
from lambent_run.job import connection as connections
from lambent_run.job.connection import Connection, Identity, RefusedError
from lambent_server.storage.s3 import S3Options
from lambent_server.workers.service import WorkerServicer
from support.api import TENANT, sha256
from support.runs import Stage, metadata, staged, token
from support.s3_server import S3Server, with_credentials

pytestmark = [pytest.mark.services, pytest.mark.slow]
MIB = 1024 * 1024
LARGE = bytes(range(256)) * (7 * MIB // 256)


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[S3Server]:
    with with_credentials(), S3Server(tmp_path_factory.mktemp("s3")) as server:
        server.client().create_bucket(Bucket="bucket")
        yield server


@pytest.fixture
def stage(server: S3Server, tmp_path: Path) -> Iterator[Stage]:
    where = {"store": "s3://bucket/runs", "store_endpoint": server.url, "store_region": "us-east-1"}
    with staged(tmp_path, **where, store_whole_bytes=MIB, store_part_bytes=5 * MIB) as stage:
        yield stage


@pytest.fixture
def run(stage: Stage) -> Iterator[Connection]:
    job_id = stage.start()
    work_dir = stage.api.services.settings.data
    identity = Identity(
        job_id=job_id, run=1, address=stage.address, token=token(job_id, 1), work_dir=work_dir
    )
    connection = Connection(identity)
    yield connection
    connection.close()


@pytest.fixture
def no_bytes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the API carry no bytes."""

    def refuse(_self: Any, _request: Any, context: Any) -> Any:
        context.abort(grpc.StatusCode.INVALID_ARGUMENT, "the API carries no bytes")

    monkeypatch.setattr(WorkerServicer, "PutBlob", refuse)
    monkeypatch.setattr(WorkerServicer, "GetBlob", refuse)


def written(folder: Path, data: bytes) -> Path:
    path = folder / "file"
    path.write_bytes(data)
    return path


@pytest.mark.parametrize("data", [b"", b"small", LARGE])
@pytest.mark.usefixtures("no_bytes")
def test_files_are_sent_and_fetched_without_the_api(
    run: Connection, stage: Stage, tmp_path: Path, data: bytes
):
    sent = run.put_file(written(tmp_path, data))
    assert sent.sha256 == sha256(data)
    assert stage.api.services.store.read_all(sent.sha256) == data
    run.get_file(sent.sha256, tmp_path / "fetched")
    assert (tmp_path / "fetched").read_bytes() == data


@pytest.mark.usefixtures("no_bytes")
def test_a_file_that_the_server_has_is_not_sent_again(
    run: Connection, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    path = written(tmp_path, b"twice")
    run.put_file(path)

    def never(*_: object) -> None:
        raise AssertionError("sent again")

    monkeypatch.setattr(run._store, "put", never)
    run.put_file(path)


@pytest.mark.usefixtures("no_bytes")
def test_transfers_outlast_a_store_that_is_away_for_a_while(
    run: Connection, stage: Stage, server: S3Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    run.put_file(written(tmp_path, b"before"))
    waits: list[float] = []
    server.kill()

    def sleep(seconds: float) -> None:
        waits.append(seconds)
        if len(waits) == 3:
            server.start()

    monkeypatch.setattr(connections.time, "sleep", sleep)
    sent = run.put_file(written(tmp_path, LARGE))
    assert len(waits) >= 3
    assert stage.api.services.store.read_all(sent.sha256) == LARGE


@pytest.mark.usefixtures("no_bytes")
def test_a_fetch_goes_on_where_it_broke_off(run: Connection, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    sent = run.put_file(written(tmp_path, LARGE))
    ranges: list[str | None] = []
    real = httpx2.Client.stream

    def stream(self: httpx2.Client, method: str, url: str, **more: Any) -> Any:
        ranges.append(more["headers"].get("Range"))
        return real(self, method, url, **more)

    monkeypatch.setattr(httpx2.Client, "stream", stream)
    target = tmp_path / "fetched"
    partial = target.with_name(f"fetched.{connections.os.getpid()}.partial")
    partial.write_bytes(LARGE[: 3 * MIB])
    run.get_file(sent.sha256, target)
    assert target.read_bytes() == LARGE
    assert ranges == [f"bytes={3 * MIB}-"]


def test_a_store_that_this_machine_cannot_reach_is_reached_through_the_server(
    run: Connection, stage: Stage, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    bucket = stage.api.services.store.bucket
    assert bucket is not None
    nowhere = type(bucket)(elsewhere(stage))
    nowhere.verifies = True
    for name in ("sign_put", "sign_get", "sign_part"):
        monkeypatch.setattr(bucket, name, getattr(nowhere, name))
    sent = run.put_file(written(tmp_path, b"carried"))
    run.get_file(sent.sha256, tmp_path / "fetched")
    assert (tmp_path / "fetched").read_bytes() == b"carried"


def elsewhere(stage: Stage) -> Any:
    settings = stage.api.services.settings
    public = "http://127.0.0.1:9"
    return S3Options(
        url=str(settings.store), endpoint=settings.store_endpoint, public_endpoint=public, region="us-east-1"
    )


def test_bytes_that_the_store_has_lost_are_refused_and_not_waited_for(
    run: Connection, stage: Stage, tmp_path: Path
):
    sent = run.put_file(written(tmp_path, b"lost soon"))
    stage.api.services.store.delete_bytes(sent.sha256)
    with pytest.raises(RefusedError, match="blob_damaged"):
        run.get_file(sent.sha256, tmp_path / "fetched")
    assert list(tmp_path.glob("fetched*")) == []


def test_an_address_that_expired_is_asked_for_again(
    run: Connection, stage: Stage, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    put: Callable[..., None] = run._store.put
    calls: list[str] = []

    def late(path: Path, offset: int, size: int, url: str, headers: Any) -> None:
        calls.append(url)
        if len(calls) == 1:
            time.sleep(2.1)
        put(path, offset, size, url, headers)

    monkeypatch.setattr(run._store, "put", late)
    settings = stage.api.services.settings.model_copy(update={"store_url_s": 1.0})
    object.__setattr__(stage.api.services, "settings", settings)
    sent = run.put_file(written(tmp_path, b"late"))
    assert len(calls) == 2
    assert stage.api.services.store.read_all(sent.sha256) == b"late"


def test_the_hash_of_another_tenants_file_opens_nothing(run: Connection, stage: Stage, tmp_path: Path):
    services = stage.api.services
    path, stranger = written(tmp_path, b"theirs"), type(TENANT)("stranger")
    services.store.put_file(services.database.write, stranger, path, sha256(b"theirs"), "text/plain")
    theirs = {"fence": run.identity.fence, "sha256": sha256(b"theirs")}
    with pytest.raises(grpc.RpcError) as refused:
        ask(run, stage.stub.LocateBlob, worker_pb2.LocateBlobRequest(**theirs))
    assert refused.value.code() == grpc.StatusCode.NOT_FOUND
    assert ask(
        run, stage.stub.CompleteUpload, worker_pb2.CompleteUploadRequest(**theirs, size_bytes=6.0)
    ).missing
    assert not ask(run, stage.stub.PlanUpload, worker_pb2.PlanUploadRequest(**theirs, size_bytes=6.0)).stored


def ask(run: Connection, call: Callable[..., Any], request: Any) -> Any:
    """Return what the server answers a run of this tenant."""
    return call(request, metadata=metadata(run.identity.job_id, 1, None), timeout=5)


@pytest.mark.parametrize("fields", [{"sha256": "../../x", "size_bytes": 1.0}, {"size_bytes": float("nan")}])
def test_a_name_that_is_no_hash_is_refused(run: Connection, stage: Stage, fields: dict[str, Any]):
    request = worker_pb2.PlanUploadRequest(
        **{"fence": run.identity.fence, "sha256": "0" * 64, "size_bytes": 1.0, **fields}
    )
    with pytest.raises(grpc.RpcError) as refused:
        ask(run, stage.stub.PlanUpload, request)
    assert refused.value.code() == grpc.StatusCode.INVALID_ARGUMENT
