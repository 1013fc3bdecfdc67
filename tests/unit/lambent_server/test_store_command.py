"""`lambent store` tells what is left over, and removes it when asked to."""

import json
import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer
from lambent_server.accounts import audit
from lambent_server.store_command import store
from support.api import Api, opened, sha256
from typer.testing import CliRunner, Result

OLD = time.time() - 2 * 86400

app = typer.Typer()
app.command()(store)


@pytest.fixture
def api(tmp_path: Path) -> Iterator[Api]:
    with opened(tmp_path / "data") as api:
        (tmp_path / "data" / "worker.secret").write_text("secret")
        yield api


def call(api: Api, *arguments: str) -> Result:
    return CliRunner().invoke(app, [*arguments, "--data", str(api.services.settings.data)])


def report(api: Api, *arguments: str) -> dict[str, Any]:
    return dict(json.loads(call(api, *arguments, "--json").output))


def orphan(api: Api, content: bytes) -> Path:
    digest = sha256(content)
    path = api.services.settings.data / "store" / "blobs" / digest[:2] / digest
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
    os.utime(path, (OLD, OLD))
    return path


def test_a_check_reports_and_changes_nothing_and_a_clean_removes(api: Api):
    api.scene()
    path = orphan(api, b"left over")
    assert report(api, "check") == {
        "num_blobs": 2,
        "removed": False,
        "unknown": [sha256(b"left over")],
        "unreferenced": [],
        "staged": [],
        "parts": [],
        "lost": [],
    }
    assert path.exists()
    result = call(api, "clean")
    assert (result.exit_code, path.exists()) == (0, False)
    assert "1 without a row (9 bytes), removed" in result.output
    assert report(api, "check")["unknown"] == []
    with api.services.database.read() as connection:
        assert [entry.action for entry in audit.entries(connection, audit.SERVER)] == ["store clean"]


def test_lost_files_are_named_and_give_exit_code_1(api: Api):
    api.scene({"a.png": b"lost"})
    api.services.store.delete_bytes(sha256(b"lost"))
    result = call(api, "check")
    assert result.exit_code == 1
    assert sha256(b"lost") in result.output


def test_a_database_of_another_store_removes_nothing(api: Api):
    paths = [orphan(api, b"%d" % number) for number in range(20)]
    result = call(api, "clean")
    assert result.exit_code == 2
    assert result.output.startswith("store.foreign")
    assert all(path.exists() for path in paths)


def test_a_folder_without_a_server_is_refused(tmp_path: Path):
    result = CliRunner().invoke(app, ["check", "--data", str(tmp_path)])
    assert result.exit_code == 2
    assert result.output.startswith("store.no_server")
    assert list(tmp_path.iterdir()) == []


def test_contents_are_compared_on_request_and_damaged_ones_set_aside_by_a_clean(api: Api):
    scene = api.scene({"transforms_train.json": b"{}", "one.png": b"a picture"})
    digest = sha256(b"a picture")
    path = api.services.settings.data / "store" / "blobs" / digest[:2] / digest
    path.write_bytes(b"a pictuse")
    assert call(api, "check").exit_code == 0
    found = call(api, "check", "--content")
    assert found.exit_code == 1
    assert f"1 with damaged contents\n  {digest}" in found.output
    assert report(api, "check", "--content")["damaged"] == [digest]
    assert path.read_bytes() == b"a pictuse"
    assert call(api, "clean", "--content").exit_code == 1
    assert not path.exists()
    assert report(api, "check", "--content")["lost"] == [digest]
    api.put(f"/v1/scenes/{scene}/files/{digest}", content=b"a picture")
    again = api.post("/v1/scenes", json={"name": "again"}).json()["id"]
    plan = [{"path": "one.png", "size": 9, "sha256": digest}]
    assert api.post(f"/v1/scenes/{again}/files:plan", json=plan).json()["missing"] == [digest]
    assert api.put(f"/v1/scenes/{again}/files/{digest}", content=b"a picture").status_code == 204
    assert call(api, "check", "--content").exit_code == 0
