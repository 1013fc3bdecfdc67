"""A server whose files are in a real S3 server, through bad days of either."""

import os
import re
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx2
import pytest
from lambent import Client, Scene
from lambent.connection import Connection
from lambent_server.serving import free_port
from support.faulty_store import FaultyStore
from support.live_server import LiveServer
from support.s3_server import S3Server, with_credentials

pytestmark = [pytest.mark.services, pytest.mark.slow]
MIB = 1024 * 1024
LARGE = os.urandom(MIB) * 16
AWAY_S = float(os.environ.get("LAMBENT_CHAOS_STORE_AWAY_S", "4"))
"""How long the store is unavailable; two minutes in the long form."""


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Iterator[S3Server]:
    with with_credentials(), S3Server(tmp_path_factory.mktemp("s3")) as server:
        server.client().create_bucket(Bucket="bucket")
        yield server


@pytest.fixture(scope="module")
def faulty(store: S3Server) -> Iterator[FaultyStore]:
    proxy = FaultyStore(store.url)
    yield proxy
    proxy.close()


@pytest.fixture(scope="module")
def server(
    store: S3Server, faulty: FaultyStore, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[LiveServer]:
    """Return a server that is started again at the same address."""
    where = {"store": "s3://bucket/live", "store_endpoint": store.url, "store_region": "us-east-1"}
    parts = {"store_whole_bytes": MIB, "store_part_bytes": 5 * MIB, "store_public_endpoint": faulty.url}
    data = tmp_path_factory.mktemp("live") / "data"
    with LiveServer(data, **where, **parts, port=free_port("127.0.0.1")) as server:
        yield server


@pytest.fixture
def client(server: LiveServer) -> Iterator[Client]:
    with Client(server.url, server.key) as client:
        yield client


@pytest.fixture
def capture(tmp_path: Path) -> Path:
    folder = tmp_path / "cup"
    folder.mkdir()
    (folder / "transforms_train.json").write_text("{}")
    (folder / "small.png").write_bytes(os.urandom(20_000))
    (folder / "large.png").write_bytes(LARGE + os.urandom(1000))
    return folder


def carried_bytes(server: LiveServer) -> float:
    """Return how many bytes of files the API has taken."""
    text = server.client.get("/metrics").text
    match = re.search(r"^lambent_upload_bytes_total (\S+)$", text, re.MULTILINE)
    assert match is not None
    return float(match[1])


def test_a_capture_becomes_a_bundle_and_the_api_carries_no_bytes(
    server: LiveServer, client: Client, capture: Path, tmp_path: Path, store: S3Server
):
    before, told = carried_bytes(server), []
    scene = client.push(capture, progress=lambda what, done, total: told.append((what, done, total)))
    total = sum(path.stat().st_size for path in capture.iterdir())
    assert told[-1] == ("upload", total, total)
    assert carried_bytes(server) == before
    job = server.wait(server.submit(scene.id, num_steps=10))
    assert (job["state"], job["run"]) == ("succeeded", 1)
    bundle = client.fetch(job["id"], tmp_path / "bundle")
    assert {file.path for file in bundle.files} == {
        path.relative_to(bundle.path).as_posix()
        for path in bundle.path.rglob("*")
        if path.is_file() and path.name != "manifest.json"
    }
    assert [key for key in store.keys("bucket") if "/uploads/" in key] == []
    # Sent once more, nothing is sent.
    told.clear()
    assert client.push(capture, progress=lambda what, done, total: told.append((what, done, total)))
    assert told[-1] == ("upload", 0, 0)


@pytest.mark.parametrize("faults", [["500", "500"], ["cut", "cut"], ["slow"], ["short", "500", "cut"]])
def test_uploads_get_through_a_store_that_has_a_bad_day(
    server: LiveServer, client: Client, capture: Path, faulty: FaultyStore, faults: list[str]
):
    before = carried_bytes(server)
    faulty.next_faults = ["", *faults]
    scene = client.push(capture)
    assert faulty.next_faults == []
    assert scene.state == "uploaded"
    assert carried_bytes(server) == before


def test_jobs_and_uploads_outlast_a_store_that_is_away(
    server: LiveServer, client: Client, capture: Path, store: S3Server
):
    job_id = server.submit(client.push(capture).id, num_steps=60, step_s=0.05, checkpoint_every=5)
    server.wait_step(job_id, 10)
    (capture / "late.png").write_bytes(os.urandom(6 * MIB))
    store.kill()
    pushed: list[Scene] = []
    pusher = threading.Thread(target=lambda: pushed.append(client.push(capture)))
    pusher.start()
    time.sleep(AWAY_S)
    store.start()
    pusher.join(timeout=60)
    assert pushed[0].state == "uploaded"
    job = server.wait(job_id)
    assert (job["state"], job["run"]) == ("succeeded", 1)


def test_an_upload_in_parts_survives_kills_of_the_server(
    server: LiveServer, client: Client, capture: Path, monkeypatch: pytest.MonkeyPatch
):
    sent: list[int] = []
    put: Callable[..., int] = Connection.put_to_store

    def then_killed(self: Connection, url: str, headers: Any, source: Path, offset: int, size: int) -> int:
        status = put(self, url, headers, source, offset, size)
        if source.name == "large.png":
            sent.append(offset)
            if len(sent) == 2:
                server.kill()
                threading.Timer(0.5, server.start).start()
        return status

    monkeypatch.setattr(Connection, "put_to_store", then_killed)
    scene = client.push(capture)
    assert scene.state == "uploaded"
    # Four parts, none of them twice.
    assert sorted(sent) == [0, 5 * MIB, 10 * MIB, 15 * MIB]


def test_a_push_that_was_broken_off_sends_only_the_rest(
    server: LiveServer, capture: Path, monkeypatch: pytest.MonkeyPatch
):
    sent: list[int] = []
    put: Callable[..., int] = Connection.put_to_store

    def interrupted(self: Connection, url: str, headers: Any, source: Path, offset: int, size: int) -> int:
        if source.name == "large.png":
            if len(sent) == 2:
                sent.append(-1)
                raise KeyboardInterrupt
            sent.append(offset)
        return put(self, url, headers, source, offset, size)

    monkeypatch.setattr(Connection, "put_to_store", interrupted)
    with Client(server.url, server.key) as first, pytest.raises(KeyboardInterrupt):
        first.push(capture)
    with Client(server.url, server.key) as second:
        assert second.push(capture).state == "uploaded"
    assert sorted(sent) == [-1, 0, 5 * MIB, 10 * MIB, 15 * MIB]


def test_a_machine_that_cannot_reach_the_store_goes_through_the_server(
    server: LiveServer, client: Client, capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    def nowhere(self: Connection) -> Any:
        def refuse(request: Any) -> Any:
            raise httpx2.ConnectError("no route", request=request)

        return httpx2.Client(transport=httpx2.MockTransport(refuse))

    monkeypatch.setattr(Connection, "_store_client", nowhere)
    before = carried_bytes(server)
    scene = client.push(capture)
    new = ("small.png", "large.png")
    assert carried_bytes(server) - before == sum((capture / name).stat().st_size for name in new)
    job = server.wait(server.submit(scene.id, num_steps=5))
    assert client.fetch(job["id"], tmp_path / "bundle").files
