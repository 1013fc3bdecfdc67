"""Leftovers of kills and failing disks: bytes without rows, rows without bytes."""

import errno
import os
import time
from pathlib import Path

import pytest
from lambent_server.maintenance.housekeeping import sweep
from lambent_server.running.reconciler import Reconciler, examine, note_key_uses, reconcile
from support.api import TENANT, Api, expect, opened, served, sha256

OLD = time.time() - 2 * 86400
CONTENT = b"{}"


api = served()


def blob(api: Api, content: bytes) -> Path:
    digest = sha256(content)
    return api.services.settings.data / "store" / "blobs" / digest[:2] / digest


def put(api: Api, content: bytes, at: float) -> Path:
    """Write bytes that no row names, as a server that was killed leaves them."""
    path = blob(api, content)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
    os.utime(path, (at, at))
    return path


def test_old_bytes_without_a_row_go_and_young_ones_and_named_ones_stay(api: Api):
    api.scene()
    os.utime(blob(api, CONTENT), (OLD, OLD))
    old, young = put(api, b"old", OLD), put(api, b"young", time.time())
    half = old.with_name(f"{old.name}#1")
    half.touch()
    os.utime(half, (OLD, OLD))
    assert reconcile(api.services) == 0
    assert not old.exists()
    assert not half.exists()
    assert young.exists()
    assert blob(api, CONTENT).exists()


@pytest.mark.parametrize("damage", [Path.unlink, lambda path: path.write_bytes(b"{")])
def test_a_row_whose_bytes_are_gone_or_cut_is_counted_and_sent_again(api: Api, damage):
    api.scene()
    damage(blob(api, CONTENT))
    assert reconcile(api.services) == 1
    api.scene()
    assert blob(api, CONTENT).read_bytes() == CONTENT
    assert reconcile(api.services) == 0


def test_a_store_that_was_away_has_lost_nothing_when_it_comes_back(api: Api):
    api.scene()
    path = blob(api, CONTENT)
    away = path.with_name("away")
    path.rename(away)
    assert reconcile(api.services) == 1
    away.rename(path)
    os.utime(path, (OLD, OLD))
    assert reconcile(api.services) == 0
    assert path.read_bytes() == CONTENT


def test_a_database_that_knows_little_of_the_store_removes_nothing(api: Api):
    api.scene()
    unknown = [put(api, b"%d" % number, OLD) for number in range(20)]
    folder = api.services.settings.runs / "job_of_another_database"
    folder.mkdir()
    os.utime(folder, (OLD, OLD))
    reconcile(api.services)
    assert all(path.exists() for path in (*unknown, folder))


def test_bytes_that_get_a_row_while_the_store_is_compared_stay(api: Api, monkeypatch: pytest.MonkeyPatch):
    path = put(api, CONTENT, OLD)
    listed = api.services.store.listed

    def then_uploaded(digits: str, *folder: str) -> dict[str, tuple[int, float]]:
        found = listed(digits, *folder)
        if path.name in found:
            api.scene()
            os.utime(path, (OLD, OLD))
        return found

    monkeypatch.setattr(api.services.store, "listed", then_uploaded)
    reconcile(api.services)
    assert path.exists()


def test_files_that_were_planned_and_never_sent_are_not_missing(api: Api):
    scene_id = expect(api.post("/v1/scenes", json={"name": "x"}), 201)["id"]
    plan = [{"path": "a.png", "size": 2, "sha256": "0" * 64}]
    expect(api.post(f"/v1/scenes/{scene_id}/files:plan", json=plan), 200)
    assert reconcile(api.services) == 0


def test_folders_of_broken_uploads_and_of_deleted_jobs_go_when_they_are_old(api: Api):
    settings, job_id = api.services.settings, api.job()["id"]
    folders = {
        "archive": settings.scratch / "tmp1",
        "young": settings.scratch / "tmp2",
        "deleted": settings.runs / "job_gone",
        "known": settings.runs / job_id,
    }
    for name, folder in folders.items():
        folder.mkdir()
        (folder / "000001").write_bytes(b"x")
        if name != "young":
            os.utime(folder, (OLD, OLD))
    reconcile(api.services)
    assert {name for name, folder in folders.items() if folder.exists()} == {"young", "known"}


def test_a_start_clears_what_uploads_have_left(tmp_path: Path):
    left = tmp_path / "data" / "scratch" / "tmp1"
    left.mkdir(parents=True)
    (left / "000001").write_bytes(b"x")
    with opened(tmp_path / "data"):
        assert not left.exists()


def test_an_archive_is_unpacked_where_the_next_start_clears_up(api: Api, monkeypatch: pytest.MonkeyPatch):
    folders: list[Path] = []

    def unpack(_archive: Path, folder: Path, _settings: object, _room: object) -> None:
        folders.append(folder.parent)
        raise OSError(errno.ENOSPC, "killed here")

    monkeypatch.setattr("lambent_server.scenes.routes.unpack", unpack)
    scene_id = expect(api.post("/v1/scenes", json={"name": "x"}), 201)["id"]
    assert api.put(f"/v1/scenes/{scene_id}/archive", content=b"PK").status_code == 507
    assert folders == [api.services.settings.scratch]


def test_the_reconciler_looks_at_the_start_and_health_tells_what_it_found(api: Api):
    api.scene()
    blob(api, CONTENT).unlink()
    api.app.state.reconciler = reconciler = Reconciler(api.services)
    reconciler.start()
    deadline = time.monotonic() + 10
    while reconciler.num_missing == 0 and time.monotonic() < deadline:
        time.sleep(0.01)
    reconciler.close()
    answer = expect(api.get("/readyz"), 200)
    assert answer["checks"]["files"] == "1 missing"


def test_when_a_key_was_used_is_written_down(api: Api):
    assert expect(api.get("/v1/keys"), 200)["items"][0]["last_used_at"] is None
    note_key_uses(api.services)
    assert expect(api.get("/v1/keys"), 200)["items"][0]["last_used_at"] is not None


def test_a_file_that_was_sent_and_that_nothing_refers_to_goes_when_it_is_old(
    api: Api, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    api.scene()
    source = tmp_path / "x"
    source.write_bytes(b"of a run that was killed")
    digest = sha256(b"of a run that was killed")
    with monkeypatch.context() as earlier:
        earlier.setattr("lambent_server.storage.store.now", lambda: OLD)
        earlier.setattr("lambent_server.cluster.claims.now", lambda: OLD)
        api.services.store.put_file(api.services.database.write, TENANT, source, digest, "text/plain")
    reconcile(api.services)
    monkeypatch.setattr("lambent_server.maintenance.housekeeping.now", lambda: time.time() + 3600)
    assert sweep(api.services) == 1
    assert not blob(api, b"of a run that was killed").exists()
    assert blob(api, CONTENT).exists()


def test_looking_changes_nothing(api: Api):
    api.scene()
    old = put(api, b"old", OLD)
    found = examine(api.services)
    assert (found.num_blobs, found.unknown, found.lost) == (2, {sha256(b"old"): 3}, [])
    assert old.exists()
