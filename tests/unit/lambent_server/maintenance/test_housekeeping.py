"""Bytes that are swept away, and bytes that stay."""

import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from lambent_server.api.problems import Problem
from lambent_server.maintenance.housekeeping import is_more_due, sweep
from lambent_server.storage.store import touch
from support.api import STRANGER_KEY, TENANT, Api, expect, opened, sha256

MAP = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 2 +X 4\n" + bytes(32)
DIGEST = sha256(MAP)
LATER_S = 1000.0


@pytest.fixture
def api(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Api]:
    """Return a server with a scene that holds a map, and whose sweeper thinks that it is later."""
    with opened(tmp_path / "data", garbage_after_s=100.0) as api:
        monkeypatch.setattr("lambent_server.maintenance.housekeeping.now", lambda: time.time() + LATER_S)
        yield api


def forgotten(api: Api) -> None:
    """Upload a scene that holds the map, and delete it."""
    scene_id = api.scene({"light.hdr": MAP})
    expect(api.delete(f"/v1/scenes/{scene_id}"), 204)


def is_stored(api: Api) -> bool:
    try:
        return api.services.store.read_all(DIGEST) == MAP
    except Problem:
        return False


def test_bytes_that_nothing_refers_to_are_removed(api: Api):
    forgotten(api)
    assert is_stored(api)
    assert sweep(api.services) == 1
    assert not is_stored(api)
    assert sweep(api.services) == 0


def test_bytes_that_were_just_sent_again_stay(api: Api, monkeypatch: pytest.MonkeyPatch):
    forgotten(api)
    monkeypatch.setattr("lambent_server.storage.store.now", lambda: time.time() + LATER_S)
    with api.services.database.write() as connection:
        assert touch(connection, TENANT, DIGEST)
    assert sweep(api.services) == 0
    assert is_stored(api)


def test_an_environment_keeps_its_bytes_when_a_scene_with_the_same_is_deleted(api: Api):
    expect(api.post("/v1/environments", params={"name": "sky"}, content=MAP), 201)
    forgotten(api)
    assert sweep(api.services) == 0
    assert api.get(f"/v1/blobs/{DIGEST}").content == MAP


def test_bytes_that_another_tenant_has_too_stay(api: Api):
    stranger = api.other(STRANGER_KEY)
    expect(stranger.post("/v1/environments", params={"name": "sky"}, content=MAP), 201)
    forgotten(api)
    assert sweep(api.services) == 0
    assert stranger.get(f"/v1/blobs/{DIGEST}").content == MAP
    assert api.get(f"/v1/blobs/{DIGEST}").status_code == 404


def test_a_sweep_removes_a_few_blobs_and_says_that_more_are_due(api: Api, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("lambent_server.maintenance.housekeeping.AT_ONCE", 2)
    scene_id = api.scene({f"{number}.png": b"%d" % number for number in range(5)})
    expect(api.delete(f"/v1/scenes/{scene_id}"), 204)
    removed = []
    while is_more_due(api.services):
        removed.append(sweep(api.services))
    assert removed == [2, 2, 1]


def test_a_sweep_ends_in_time_where_every_removal_is_slow(api: Api, monkeypatch: pytest.MonkeyPatch):
    scene = api.scene({f"{number}.json": str(number).encode() for number in range(3)})
    expect(api.delete(f"/v1/scenes/{scene}"), 204)
    monkeypatch.setattr("lambent_server.maintenance.housekeeping.SWEEP_S", -1.0)
    assert [sweep(api.services) for _ in range(4)] == [1, 1, 1, 0]


def test_blobs_that_were_just_sent_again_do_not_keep_others_from_being_removed(
    api: Api, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("lambent_server.maintenance.housekeeping.AT_ONCE", 1)
    forgotten(api)
    other = api.scene({"other.png": b"other"})
    expect(api.delete(f"/v1/scenes/{other}"), 204)
    monkeypatch.setattr("lambent_server.storage.store.now", lambda: time.time() + LATER_S)
    with api.services.database.write() as connection:
        assert touch(connection, TENANT, DIGEST)
    assert [sweep(api.services) for _ in range(2)] == [0, 1]
    assert not is_more_due(api.services)
    assert is_stored(api)
    # Later they are due like all others.
    monkeypatch.setattr("lambent_server.maintenance.housekeeping.now", lambda: time.time() + 2 * LATER_S)
    assert sweep(api.services) == 1
    assert not is_stored(api)


def test_a_deletion_that_was_cut_short_is_finished_by_the_next_sweep(
    api: Api, monkeypatch: pytest.MonkeyPatch
):
    forgotten(api)
    with monkeypatch.context() as killed:
        killed.setattr(type(api.services.store), "delete", lambda *_: False)
        assert sweep(api.services) == 0
    assert is_stored(api)
    assert sweep(api.services) == 1
    assert not is_stored(api)
