"""Bytes that change in the store of a running server: jobs say so, and an ordinary push repairs them."""

import contextlib
import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from lambent import Client
from lambent_server.storage.store import BlobStore
from support.api import sha256
from support.databases import postgresql
from support.live_server import LiveServer, wait_until
from support.s3_server import S3Server, with_credentials

pytestmark = [pytest.mark.slow]


@pytest.fixture(params=["sqlite", pytest.param("postgresql", marks=pytest.mark.services)])
def server(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[LiveServer]:
    with contextlib.ExitStack() as stack:
        given = {} if request.param == "sqlite" else {"database": stack.enter_context(postgresql())}
        yield stack.enter_context(LiveServer(tmp_path / "data", **given))


@pytest.fixture
def capture(tmp_path: Path) -> Path:
    folder = tmp_path / "cup"
    folder.mkdir()
    (folder / "transforms_train.json").write_text("{}")
    (folder / "one.png").write_bytes(os.urandom(200_000))
    return folder


def flip(path: Path) -> None:
    """Change one bit as a disk does it, which tells nobody."""
    before = path.stat()
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    with path.open("r+b") as file:
        file.write(data)
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))


def blobs(server: LiveServer) -> list[Path]:
    return list((server.data / "store" / "blobs").glob("??/*"))


def push(server: LiveServer, capture: Path) -> str:
    with Client(server.url, server.key) as client:
        return client.push(capture).id


def test_a_job_with_a_damaged_capture_says_so_and_the_same_push_repairs_it(server: LiveServer, capture: Path):
    scene = push(server, capture)
    path = server.data / "store" / BlobStore.key(sha256((capture / "one.png").read_bytes()))
    flip(path)
    failed = server.wait(server.submit(scene, num_steps=2))
    assert failed["state"] == "failed"
    assert failed["error"]["code"] == "scene.file_damaged", failed["error"]
    assert failed["error"]["message"].startswith("one.png: ")
    assert failed["run"] == 1
    assert server.client.get("/readyz").json()["checks"]["files"] == "1 missing"
    push(server, capture)
    assert path.read_bytes() == (capture / "one.png").read_bytes()
    assert server.wait(server.submit(scene, num_steps=2))["state"] == "succeeded"
    assert server.client.get("/readyz").json()["checks"]["files"] == "ok"


def test_a_push_alone_finds_the_damage(server: LiveServer, capture: Path):
    scene = push(server, capture)
    path = server.data / "store" / BlobStore.key(sha256((capture / "one.png").read_bytes()))
    flip(path)
    push(server, capture)
    assert server.wait(server.submit(scene, num_steps=2))["state"] == "succeeded"


def test_a_run_goes_on_from_the_checkpoint_before_a_damaged_one(server: LiveServer):
    scene = server.scene()
    job = server.submit(scene, num_steps=300, step_s=0.02, checkpoint_every=20)
    server.wait_step(job, 65)
    (newest,) = [path for path in blobs(server) if b'"step": 60,' in path.read_bytes()]
    flip(newest)
    server.supervisor(job).kill()
    assert server.wait(job)["state"] == "succeeded"
    log = server.client.get(f"/v1/jobs/{job}/log").text
    steps = [json.loads(line)["first_step"] for line in log.splitlines() if '"first_step"' in line]
    assert steps[0] == 0
    assert steps[1] >= 40
    assert steps[1] != 60


@pytest.mark.services
def test_other_bytes_in_a_bucket_are_neither_served_nor_pointed_at(tmp_path: Path, capture: Path):
    with with_credentials(), S3Server(tmp_path / "s3") as s3:
        s3.client().create_bucket(Bucket="bucket")
        where = {"store": "s3://bucket/live", "store_endpoint": s3.url, "store_region": "us-east-1"}
        with LiveServer(tmp_path / "data", **where) as server:
            scene = push(server, capture)
            data = bytearray((capture / "one.png").read_bytes())
            digest = sha256(bytes(data))
            assert read(server, digest).content == data
            data[7] ^= 1
            key = f"live/{BlobStore.key(digest)}"
            s3.client().put_object(Bucket="bucket", Key=key, Body=bytes(data))
            assert read(server, digest, {"x-lambent-redirect": "1"}).status_code == 410
            assert read(server, digest).json()["code"] == "blob_damaged"
            aside = s3.client().get_object(Bucket="bucket", Key=f"live/{BlobStore.key(digest, 'damaged')}")
            assert aside["Body"].read() == data
            push(server, capture)
            assert read(server, digest).content == (capture / "one.png").read_bytes()
            s3.client().put_object(Bucket="bucket", Key=key, Body=bytes(data))
            failed = server.wait(server.submit(scene, num_steps=2))
            assert failed["error"]["code"] == "scene.file_damaged"


def read(server: LiveServer, digest: str, headers: dict[str, str] | None = None) -> Any:
    return server.client.get(f"/v1/blobs/{digest}", headers=headers or {}, follow_redirects=False)


@pytest.mark.services
def test_the_scrubber_of_a_server_finds_what_nobody_reads(tmp_path: Path, capture: Path):
    with LiveServer(tmp_path / "data", scrub_every_s=0.5, scrub_bytes_per_s=10_000_000) as server:
        push(server, capture)
        path = server.data / "store" / BlobStore.key(sha256((capture / "one.png").read_bytes()))
        server.end()
        flip(path)
        server.start()
        wait_until(lambda: not path.exists(), timeout_s=30.0)
        answer = server.client.get(f"/v1/blobs/{path.name}")
        assert (answer.status_code, answer.json()["code"]) == (410, "blob_damaged")
