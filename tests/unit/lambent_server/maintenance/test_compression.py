"""Compressed copies of bundles' files: which are made, when, and when they are removed."""

import gzip
import os
import shutil
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from lambent_server.database.schema import bundle_files
from lambent_server.maintenance import compression
from lambent_server.maintenance.compression import Compressor
from lambent_server.maintenance.housekeeping import sweep
from lambent_server.running.reconciler import reconcile
from lambent_server.storage.outages import Stopped
from lambent_server.storage.store import LOST
from sqlalchemy import select
from support.api import STRANGER, Api, expect, opened, served, sha256
from support.live_server import wait_until
from support.server_rows import add_bundle

PLANES = bytes(range(200)) * 400
NOISE = os.urandom(50_000)
OLD = time.time() - 2 * 86400


api = served(garbage_after_s=0.001)


def compress(api: Api) -> int:
    return Compressor(api.services, lambda: True).turn()


def copy_of(api: Api, data: bytes) -> Path:
    digest = sha256(data)
    return api.services.settings.data / "store" / "gzip" / digest[:2] / digest


def known(api: Api, bundle_id: str = "bundle_x") -> dict[str, float | None]:
    """Return what the rows of a bundle say about its copies, by path."""
    columns = select(bundle_files.c.path, bundle_files.c.gzip_bytes)
    with api.services.database.read() as connection:
        found = connection.execute(columns.where(bundle_files.c.bundle_id == bundle_id))
        return dict(found.all())


def test_what_gains_is_compressed_whatever_its_name_is(api: Api, tmp_path: Path):
    files = {"planes.png": PLANES, "noise.json": NOISE, "empty": b"", "short.txt": b"aaaaaaaa"}
    add_bundle(api, tmp_path, files)
    assert compress(api) == 1
    copy = copy_of(api, PLANES)
    assert gzip.decompress(copy.read_bytes()) == PLANES
    assert known(api) == {"planes.png": copy.stat().st_size, "noise.json": 0, "empty": 0, "short.txt": 0}
    assert [path for path in copy.parents[1].rglob("*") if path.is_file()] == [copy]
    assert list(api.services.settings.scratch.iterdir()) == []


def test_nothing_is_compressed_twice(api: Api, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    add_bundle(api, tmp_path, {"planes.bin": PLANES, "noise.bin": NOISE})
    assert compress(api) == 1
    monkeypatch.setattr(compression.zlib, "compressobj", None)
    assert compress(api) == 0
    # The same files of another bundle, even of another tenant: what is known of them holds.
    add_bundle(api, tmp_path, {"a": PLANES, "b": NOISE}, bundle_id="bundle_y", tenant=STRANGER)
    assert compress(api) == 0
    assert known(api, "bundle_y") == {"a": copy_of(api, PLANES).stat().st_size, "b": 0}


def test_a_copy_goes_with_the_last_bundle_that_has_the_file(api: Api, tmp_path: Path):
    for name in ("bundle_x", "bundle_y"):
        add_bundle(api, tmp_path, {"manifest.json": b"{}", "planes.bin": PLANES}, bundle_id=name)
    compress(api)
    expect(api.delete("/v1/bundles/bundle_x"), 204)
    time.sleep(0.01)
    sweep(api.services)
    assert copy_of(api, PLANES).is_file()
    expect(api.delete("/v1/bundles/bundle_y"), 204)
    time.sleep(0.01)
    sweep(api.services)
    assert not copy_of(api, PLANES).exists()


def test_a_bundle_that_is_deleted_meanwhile_leaves_no_copy(
    api: Api, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    add_bundle(api, tmp_path, {"planes.bin": PLANES})
    put = api.services.store.put_copy

    def then_deleted(sha256_: str, path: Path) -> None:
        put(sha256_, path)
        expect(api.delete("/v1/bundles/bundle_x"), 204)

    monkeypatch.setattr(api.services.store, "put_copy", then_deleted)
    assert compress(api) == 0
    assert not copy_of(api, PLANES).exists()


def test_no_row_names_a_copy_before_it_is_whole_and_on_the_disk(
    api: Api, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    add_bundle(api, tmp_path, {"planes.bin": PLANES})
    put = api.services.store.put_copy

    def noted(sha256_: str, path: Path) -> None:
        put(sha256_, path)
        assert gzip.decompress(copy_of(api, PLANES).read_bytes()) == PLANES
        assert known(api) == {"planes.bin": None}

    monkeypatch.setattr(api.services.store, "put_copy", noted)
    assert compress(api) == 1


@pytest.mark.parametrize("damage", [Path.unlink, lambda path: path.write_bytes(b"cut")])
def test_a_damaged_copy_is_made_again(api: Api, tmp_path: Path, damage):
    add_bundle(api, tmp_path, {"planes.bin": PLANES})
    compress(api)
    copy = copy_of(api, PLANES)
    whole = copy.read_bytes()
    damage(copy)
    # Nothing is lost: the file is there.
    assert reconcile(api.services) == 0
    assert known(api) == {"planes.bin": None}
    assert compress(api) == 1
    assert copy.read_bytes() == whole


def test_old_copies_that_no_row_names_are_removed_and_others_stay(api: Api, tmp_path: Path):
    add_bundle(api, tmp_path, {"planes.bin": PLANES})
    compress(api)
    named, old, young = copy_of(api, PLANES), copy_of(api, b"old"), copy_of(api, b"young")
    for path, at in ((named, OLD), (old, OLD), (young, time.time())):
        path.parent.mkdir(parents=True, exist_ok=True)
        if path != named:
            path.write_bytes(b"x")
        os.utime(path, (at, at))
    assert reconcile(api.services) == 0
    assert [path.exists() for path in (named, old, young)] == [True, False, True]


def test_a_file_whose_bytes_are_gone_is_passed_over_until_the_reconciler_finds_them(api: Api, tmp_path: Path):
    lost = PLANES + b"lost"
    add_bundle(api, tmp_path, {"lost.bin": lost, "planes.bin": PLANES})
    blob = next((api.services.settings.data / "store" / "blobs").rglob(sha256(lost)))
    blob.rename(tmp_path / "away")
    assert compress(api) == 1
    assert known(api)["lost.bin"] == LOST
    assert reconcile(api.services) == 1
    assert compress(api) == 0
    shutil.move(tmp_path / "away", blob)
    assert compress(api) == 0
    assert reconcile(api.services) == 0
    assert compress(api) == 1
    assert known(api)["lost.bin"] == copy_of(api, lost).stat().st_size


def test_a_file_that_was_gone_is_compressed_with_the_next_bundle_that_brings_it(api: Api, tmp_path: Path):
    add_bundle(api, tmp_path, {"lost.bin": PLANES})
    next((api.services.settings.data / "store" / "blobs").rglob(sha256(PLANES))).unlink()
    assert compress(api) == 0
    add_bundle(api, tmp_path, {"again.bin": PLANES}, bundle_id="bundle_y")
    assert compress(api) == 1
    size = copy_of(api, PLANES).stat().st_size
    assert known(api) | known(api, "bundle_y") == {"lost.bin": size, "again.bin": size}


def test_a_full_disk_is_left_alone(tmp_path: Path):
    with opened(tmp_path / "data", disk_floor_bytes=1 << 60) as api:
        add_bundle(api, tmp_path, {"planes.bin": PLANES})
        assert compress(api) == 0
        assert known(api) == {"planes.bin": None}


def test_the_thread_compresses_what_is_published_if_this_server_leads(
    api: Api, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(compression, "TICK_S", 0.05)
    leads = threading.Event()
    compressor = Compressor(api.services, leads.is_set)
    compressor.rounds.start()
    try:
        add_bundle(api, tmp_path, {"planes.bin": PLANES})
        api.services.wakeups.signal()
        time.sleep(1.5)
        assert known(api) == {"planes.bin": None}
        leads.set()
        wait_until(lambda: known(api)["planes.bin"], 20.0)
    finally:
        compressor.rounds.close()


def test_a_stop_does_not_wait_for_the_end_of_a_file(
    api: Api, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    add_bundle(api, tmp_path, {"planes.bin": PLANES})
    compressor = Compressor(api.services, lambda: True)
    read = api.services.store.read

    def slow(*given: object) -> Iterator[bytes]:
        for piece in (*read(*given), b"more"):
            yield piece
            compressor.rounds._stopping.set()

    monkeypatch.setattr(api.services.store, "read", slow)
    with pytest.raises(Stopped):
        compressor.turn()
    assert known(api) == {"planes.bin": None}
    assert list(api.services.settings.scratch.iterdir()) == []
