"""A bucket of a real S3 server: what is refused when a server starts, and what the addresses allow."""

import datetime
from collections.abc import Iterator, Mapping
from typing import Any

import httpx2
import pytest
from lambent_server.storage.s3 import S3Bucket, S3Options, StoreSetupError, StoreUnavailableError
from support.api import sha256
from support.s3_server import S3Server, with_credentials

pytestmark = [pytest.mark.services, pytest.mark.slow]


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[S3Server]:
    with with_credentials(), S3Server(tmp_path_factory.mktemp("s3")) as server:
        server.bucket("bucket")
        yield server


@pytest.fixture
def bucket(server: S3Server) -> S3Bucket:
    bucket = S3Bucket(options(server))
    bucket.check()
    return bucket


def options(server: S3Server, **given: Any) -> S3Options:
    values = {"url": "s3://bucket/prefix", "endpoint": server.url, "region": "us-east-1", **given}
    return S3Options(**values)


def send(url: str, data: bytes, headers: Mapping[str, str]) -> int:
    """Return the status of a PUT by someone without credentials."""
    given = {"content-type": "application/octet-stream", **headers}
    return httpx2.put(url, content=data, headers=given, timeout=20).status_code


def test_a_check_finds_that_the_server_verifies_checksums_and_leaves_nothing(
    bucket: S3Bucket, server: S3Server
):
    assert bucket.verifies
    assert server.keys("bucket") == []


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"url": "s3://nowhere"}, "there is no bucket 'nowhere'"),
        ({"url": "s3://"}, "names no bucket"),
        ({"endpoint": "http://127.0.0.1:9"}, "does not answer"),
    ],
)
def test_a_store_that_cannot_be_used_is_refused_with_the_reason(
    server: S3Server, given: dict[str, str], words: str
):
    with pytest.raises(StoreSetupError, match=words):
        S3Bucket(options(server, **given)).check()


def test_wrong_credentials_missing_ones_and_missing_rights_are_told_apart(
    server: S3Server, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "wrong")
    with pytest.raises(StoreSetupError, match="refuses the credentials") as refused:
        S3Bucket(options(server)).check()
    assert "wrong" not in str(refused.value)
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", "test:reader")
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "reading")
    with pytest.raises(StoreSetupError, match="may not list the bucket"):
        S3Bucket(options(server)).check()
    monkeypatch.delenv("AWS_SECRET_ACCESS_KEY")
    monkeypatch.delenv("AWS_ACCESS_KEY_ID")
    with pytest.raises(StoreSetupError, match="there are no credentials"):
        S3Bucket(options(server))


def test_a_clock_that_is_wrong_is_named(server: S3Server, monkeypatch: pytest.MonkeyPatch):
    class Wrong(datetime.datetime):
        @classmethod
        def now(cls, tz: Any = None) -> Any:
            return super().now(tz) + datetime.timedelta(hours=1)

        @classmethod
        def utcnow(cls) -> Any:
            return cls.now(datetime.UTC).replace(tzinfo=None)

    bucket = S3Bucket(options(server))
    monkeypatch.setattr("botocore.auth.get_current_datetime", Wrong.utcnow)
    with pytest.raises(StoreSetupError, match="clocks"):
        bucket.check()


def test_an_address_takes_exactly_the_bytes_that_were_announced(bucket: S3Bucket):
    data = b"photograph"
    url, headers = bucket.sign_put("uploads/a", sha256(data), len(data), 60)
    assert send(url, b"photograpH", headers) == 400
    assert send(url, b"photographs", headers) == 403
    assert send(url, data, {}) == 403
    assert send(url.replace("uploads/a", "uploads/b"), data, headers) == 403
    assert bucket.head("uploads/a") is None
    assert send(url, data, headers) == 200
    version = bucket.head("uploads/a")
    assert version is not None
    assert b"".join(bucket.read("uploads/a", version)) == data
    bucket.delete("uploads/a")


def test_an_address_for_reading_gives_the_type_and_expires(bucket: S3Bucket):
    url, headers = bucket.sign_put("uploads/c", sha256(b"x"), 1, 60)
    assert send(url, b"x", headers) == 200
    answer = httpx2.get(bucket.sign_get("uploads/c", "image/png", 60), timeout=20)
    assert (answer.content, answer.headers["content-type"]) == (b"x", "image/png")
    assert bucket.sign_get("uploads/c", "image/png", 60).startswith(bucket.origin)
    bucket.delete("uploads/c")


def test_copies_are_of_exactly_one_version(bucket: S3Bucket):
    url, headers = bucket.sign_put("uploads/d", sha256(b"1"), 1, 60)
    send(url, b"1", headers)
    version = bucket.head("uploads/d")
    assert version is not None
    url, headers = bucket.sign_put("uploads/d", sha256(b"2"), 1, 60)
    send(url, b"2", headers)
    with pytest.raises(FileNotFoundError):
        bucket.copy("uploads/d", version, "blobs/d")
    assert bucket.head("blobs/d") is None
    bucket.delete("uploads/d")


def test_a_server_that_is_away_is_unavailable_and_not_empty(server: S3Server, bucket: S3Bucket):
    server.kill()
    try:
        with pytest.raises(StoreUnavailableError):
            bucket.head("uploads/a")
    finally:
        server.start()
    assert bucket.head("uploads/a") is None


def test_a_bucket_that_is_gone_while_the_server_runs_is_waited_for(server: S3Server, bucket: S3Bucket):
    """A store that is coming back may say so for a moment."""
    gone = S3Bucket(options(server, url="s3://nowhere"))
    url, headers = bucket.sign_put("uploads/e", sha256(b"1"), 1, 60)
    send(url, b"1", headers)
    version = bucket.head("uploads/e")
    assert version is not None
    with pytest.raises(StoreUnavailableError, match="NoSuchBucket"):
        gone.copy("uploads/e", version, "blobs/e")
    with pytest.raises(StoreUnavailableError, match="NoSuchBucket"):
        b"".join(gone.read("uploads/e", version))
    bucket.delete("uploads/e")
