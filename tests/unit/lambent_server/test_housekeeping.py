"""Which bytes are swept away, and whose stay."""

import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from lambent_server.housekeeping import sweep
from lambent_server.problems import Problem
from lambent_server.store import touch
from support.api import STRANGER_KEY, TENANT, Api, expect, opened, sha256

MAP = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 2 +X 4\n" + bytes(32)
DIGEST = sha256(MAP)
LATER_S = 1000.0


@pytest.fixture
def api(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Api]:
    """Return a server with a scene that holds a map, and whose sweeper thinks that it is later."""
    with opened(tmp_path / "data", garbage_after_s=100.0) as api:
        monkeypatch.setattr("lambent_server.housekeeping.now", lambda: time.time() + LATER_S)
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
    monkeypatch.setattr("lambent_server.store.now", lambda: time.time() + LATER_S)
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
