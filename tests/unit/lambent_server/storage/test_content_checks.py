"""Bytes that have changed in the store: never served, asked for again, and repaired by an ordinary upload."""

import gzip
import os
import time
import zlib
from pathlib import Path

import pytest
from lambent_server.maintenance.compression import Compressor
from lambent_server.maintenance.scrubber import Scrubber, due
from lambent_server.storage import content_checks
from lambent_server.storage.content_checks import BLOBS, DAMAGED, GZIP
from lambent_server.storage.store import BlobStore
from sqlalchemy import text
from support.api import Api, expect, expect_problem, opened, served, sha256

PICTURE = bytes(range(256)) * 4096


api = served(databases=("sqlite", "postgresql"), scrub_every_s=3600.0)


def path_of(api: Api, digest: str, folder: str = BLOBS) -> Path:
    return api.services.settings.data / "store" / BlobStore.key(digest, folder)


def flip(path: Path, *, quietly: bool = False) -> None:
    """Change one bit in the middle of a file; `quietly` as a disk does it, which tells nobody."""
    before = path.stat()
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    if quietly:
        os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))


def sent(api: Api, data: bytes = PICTURE) -> tuple[str, str]:
    """Return a scene with one file, and the hash of that."""
    return api.scene({"images/one.png": data}), sha256(data)


def plan(api: Api, scene: str, data: bytes = PICTURE) -> list[str]:
    """Return the files that a client would have to send for another scene of the same capture."""
    files = [{"path": "images/one.png", "size": len(data), "sha256": sha256(data)}]
    return expect(api.post(f"/v1/scenes/{scene}/files:plan", json=files), 200)["missing"]


def new_scene(api: Api) -> str:
    return str(expect(api.post("/v1/scenes", json={"name": "again"}), 201)["id"])


def restarted(api: Api) -> None:
    """Let the server know of its store what it knows after a start."""
    api.services.store.checks._known.clear()


@pytest.mark.parametrize("headers", [{}, {"range": "bytes=0-9"}])
@pytest.mark.parametrize("method", ["get", "head"])
def test_a_flipped_bit_is_never_served(api: Api, headers: dict[str, str], method: str):
    _, digest = sent(api)
    flip(path_of(api, digest))
    answer = getattr(api, method)(f"/v1/blobs/{digest}", headers=headers)
    assert answer.status_code == 410
    assert answer.headers["cache-control"] == "no-store"
    assert "etag" not in answer.headers
    expect_problem(api.get(f"/v1/blobs/{digest}"), 410, "blob_damaged")


def test_a_bit_that_a_disk_flips_is_noticed_after_a_start_and_after_a_day(
    api: Api, monkeypatch: pytest.MonkeyPatch
):
    _, digest = sent(api)
    assert api.get(f"/v1/blobs/{digest}").content == PICTURE
    flip(path_of(api, digest), quietly=True)
    monkeypatch.setattr(content_checks, "FRESH_S", 0.0)
    expect_problem(api.get(f"/v1/blobs/{digest}"), 410, "blob_damaged")


def test_a_file_that_somebody_changes_is_noticed_at_once(api: Api):
    _, digest = sent(api)
    assert api.get(f"/v1/blobs/{digest}").content == PICTURE
    flip(path_of(api, digest))
    expect_problem(api.get(f"/v1/blobs/{digest}"), 410, "blob_damaged")


def test_bytes_are_read_once_to_be_compared_and_not_again_for_every_reader(
    api: Api, monkeypatch: pytest.MonkeyPatch
):
    _, digest = sent(api)
    read: list[str] = []
    original = content_checks.ContentChecks._digest
    monkeypatch.setattr(
        content_checks.ContentChecks,
        "_digest",
        lambda self, name, *given: read.append(name) or original(self, name, *given),
    )
    for _ in range(3):
        assert api.get(f"/v1/blobs/{digest}").content == PICTURE
    assert read == [digest]
    restarted(api)
    assert api.get(f"/v1/blobs/{digest}", headers={"range": "bytes=5-9"}).content == PICTURE[5:10]
    assert read == [digest] * 2


def test_one_wrong_reading_is_no_damage(api: Api, monkeypatch: pytest.MonkeyPatch):
    _, digest = sent(api)
    original, calls = content_checks.ContentChecks._digest, []

    def wrong_at_first(self: object, name: str, *given: object) -> str | None:
        calls.append(name)
        return "0" * 64 if len(calls) == 1 else original(self, name, *given)

    monkeypatch.setattr(content_checks.ContentChecks, "_digest", wrong_at_first)
    assert api.get(f"/v1/blobs/{digest}").content == PICTURE
    assert path_of(api, digest).exists()


def test_a_plan_asks_for_damaged_bytes_and_sending_them_repairs_every_scene(api: Api):
    first, digest = sent(api)
    second = new_scene(api)
    assert plan(api, second) == []
    restarted(api)
    flip(path_of(api, digest), quietly=True)
    assert plan(api, second) == [digest]
    expect(api.put(f"/v1/scenes/{second}/files/{digest}", content=PICTURE), 204)
    assert plan(api, second) == []
    assert api.get(f"/v1/blobs/{digest}").content == PICTURE
    assert first != second
    assert api.services.store.checks.damaged == set()


def test_damaged_bytes_are_kept_aside_and_counted(api: Api):
    _, digest = sent(api)
    flip(path_of(api, digest))
    api.get(f"/v1/blobs/{digest}")
    assert not path_of(api, digest).exists()
    assert sha256(path_of(api, digest, DAMAGED).read_bytes()) != digest
    assert expect(api.get("/readyz"), 200)["checks"]["files"] == "1 missing"
    assert "lambent_blobs_damaged_total" in api.get("/metrics").text


def test_damaged_bytes_go_with_their_blob(api: Api):
    _, digest = sent(api)
    flip(path_of(api, digest))
    api.get(f"/v1/blobs/{digest}")
    assert path_of(api, digest, DAMAGED).exists()
    api.services.store.delete_bytes(digest)
    assert not path_of(api, digest, DAMAGED).exists()


def test_damaged_bytes_are_refused_even_where_they_cannot_be_set_aside(
    api: Api, monkeypatch: pytest.MonkeyPatch
):
    def refuse(*_: object) -> None:
        raise OSError(30, "Read-only file system")

    _, digest = sent(api)
    flip(path_of(api, digest))
    monkeypatch.setattr(content_checks.obstore, "copy", refuse)
    for _ in range(2):
        expect_problem(api.get(f"/v1/blobs/{digest}"), 410, "blob_damaged")
    assert path_of(api, digest).exists()


def test_bytes_that_are_sent_again_while_the_old_ones_are_set_aside_stay(
    api: Api, monkeypatch: pytest.MonkeyPatch
):
    _, digest = sent(api)
    path = path_of(api, digest)
    flip(path)
    copy = content_checks.obstore.copy

    def copy_then_send(*given: object) -> None:
        copy(*given)
        path.unlink()
        path.write_bytes(PICTURE)

    monkeypatch.setattr(content_checks.obstore, "copy", copy_then_send)
    assert api.get(f"/v1/blobs/{digest}").status_code == 410
    assert api.get(f"/v1/blobs/{digest}").content == PICTURE


def with_bundle(api: Api, data: bytes) -> str:
    """Return the hash of the one file of a bundle."""
    digest = sent(api, data)[1]
    statement = (
        "INSERT INTO bundle_files (bundle_id, path, tenant_id, sha256, size_bytes, media_type) "
        "VALUES ('bundle_x', 'a.bin', 'default', :sha256, :size, 'application/octet-stream')"
    )
    with api.services.database.write() as connection:
        tenant = {"sha256": digest, "size": len(data)}
        connection.execute(text(statement), tenant)
        row = "INSERT INTO bundles (id, tenant_id, job_id, scene_id, created_at) VALUES "
        connection.execute(text(f"{row} ('bundle_x', 'default', 'job_x', 'scene_x', 1700000000)"))
    return digest


@pytest.mark.parametrize("how", ["flipped", "of other bytes", "cut"])
def test_a_damaged_compressed_copy_is_not_served_and_made_again(api: Api, how: str):
    data = "".join(map(str, range(20_000))).encode()
    digest = with_bundle(api, data)
    assert Compressor(api.services, lambda: True).turn() == 1
    copy = path_of(api, digest, GZIP)
    size = copy.stat().st_size
    restarted(api)
    if how == "flipped":
        flip(copy)
    elif how == "cut":
        copy.write_bytes(copy.read_bytes()[:-20] + b"\0" * 20)
    else:
        packed = gzip.compress(b"\1" * 100_000, 6)[:size]
        copy.write_bytes(packed + b"\0" * (size - len(packed)))
    answer = api.get("/v1/bundles/bundle_x/files/a.bin", headers={"accept-encoding": "gzip"})
    assert (answer.status_code, answer.content) == (200, data)
    assert "content-encoding" not in answer.headers
    assert not copy.exists()
    assert api.services.store.checks.damaged == set()


def test_the_archive_of_a_bundle_never_has_wrong_bytes(api: Api):
    digest = with_bundle(api, PICTURE)
    url = "/v1/bundles/bundle_x/archive"
    found = api.get(url)
    assert found.status_code == 200
    flip(path_of(api, digest))
    expect_problem(api.get(url), 410, "blob_damaged")


def test_the_scrubber_finds_what_nobody_reads_within_its_rate(api: Api):
    _, digest = sent(api)
    others = [sent(api, bytes([number]) * 1000)[1] for number in range(3)]
    assert len(due(api.services)) == 4
    flip(path_of(api, digest), quietly=True)
    scrubber = Scrubber(api.services, lambda: True)
    paced: list[int] = []
    scrubber._pace = paced.append  # type: ignore[method-assign]
    scrubber.turn()
    assert not path_of(api, digest).exists()
    assert all(path_of(api, other).exists() for other in others)
    assert sum(paced) == 2 * len(PICTURE) + 3 * 1000
    assert due(api.services) == []


def test_the_scrubber_keeps_to_its_rate(tmp_path: Path):
    with opened(tmp_path / "data", scrub_bytes_per_s=10_000_000) as api:
        sent(api)
        began = time.monotonic()
        Scrubber(api.services, lambda: True).turn()
        assert time.monotonic() - began > 0.8 * len(PICTURE) / 10_000_000


def test_a_copy_with_bytes_behind_its_end_is_damaged():
    unpacker, digest = zlib.decompressobj(31), content_checks.hashlib.sha256()
    with pytest.raises(zlib.error):
        content_checks._unpack(unpacker, gzip.compress(b"x") + b"more", digest)
