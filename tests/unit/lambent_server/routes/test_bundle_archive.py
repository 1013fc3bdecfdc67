"""A bundle as one download."""

import io
import zipfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from lambent_relight import load_bundle
from lambent_server.database.schema import bundle_files, scenes
from lambent_server.database.tenancy import change
from support.api import STRANGER_KEY, TENANT, Api, expect_problem, opened, sha256
from support.baked_bundle import write_baked_bundle
from support.server_rows import add_bundle


@pytest.fixture(scope="module")
def api(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Api]:
    with opened(tmp_path_factory.mktemp("api") / "data") as api:
        yield api


@pytest.fixture(scope="module")
def bundle(api: Api, tmp_path_factory: pytest.TempPathFactory) -> str:
    folder = write_baked_bundle(tmp_path_factory.mktemp("b") / "boxes")
    files = {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*.*")}
    scene_id = api.scene()
    with api.services.database.write() as connection:
        connection.execute(change(TENANT, scenes).where(scenes.c.id == scene_id).values(name="Ein Bär: 1/2"))
    return add_bundle(api, tmp_path_factory.mktemp("files"), files, scene_id=scene_id)


def test_the_client_opens_the_archive_as_it_is(api: Api, bundle: str, tmp_path: Path):
    answer = api.get(f"/v1/bundles/{bundle}/archive")
    assert answer.status_code == 200
    assert answer.headers["content-type"] == "application/zip"
    assert answer.headers["content-length"] == str(len(answer.content))
    assert answer.headers["content-disposition"].endswith("''Ein%20B%C3%A4r_%201_2.relight.zip")
    path = tmp_path / "a.relight.zip"
    path.write_bytes(answer.content)
    assert load_bundle(path).manifest.HasField("transport")
    with zipfile.ZipFile(path) as archive:
        assert archive.testzip() is None


def test_an_archive_is_asked_for_again_by_its_etag(api: Api, bundle: str):
    etag = api.get(f"/v1/bundles/{bundle}/archive").headers["etag"]
    answer = api.get(f"/v1/bundles/{bundle}/archive", headers={"if-none-match": etag})
    assert (answer.status_code, answer.content) == (304, b"")


def test_an_archive_is_not_for_strangers_nor_behind_a_link(api: Api, bundle: str):
    answer = api.other(STRANGER_KEY).get(f"/v1/bundles/{bundle}/archive")
    expect_problem(answer, 404, "bundle_not_found")
    expect_problem(api.other(None).get(f"/v1/bundles/{bundle}/archive"), 401, "not_authenticated")


def test_lost_bytes_are_a_problem_before_the_download_and_a_huge_bundle_is_refused(api: Api, tmp_path: Path):
    broken = add_bundle(api, tmp_path, {"manifest.json": b"lost"}, bundle_id="bundle_lost")
    api.services.store.delete_bytes(sha256(b"lost"))
    expect_problem(api.get(f"/v1/bundles/{broken}/archive"), 410, "blob_damaged")
    huge = add_bundle(api, tmp_path, {"manifest.json": b"huge"}, bundle_id="bundle_huge")
    with api.services.database.write() as connection:
        mine = bundle_files.c.bundle_id == huge
        connection.execute(change(TENANT, bundle_files).where(mine).values(size_bytes=5.0e9))
    expect_problem(api.get(f"/v1/bundles/{huge}/archive"), 413, "archive_too_large")


def test_an_empty_name_gives_a_file_name_all_the_same(api: Api, tmp_path: Path):
    bundle = add_bundle(api, tmp_path, {"manifest.json": b"{}"}, bundle_id="bundle_nameless", scene_id="gone")
    answer = api.get(f"/v1/bundles/{bundle}/archive")
    assert answer.headers["content-disposition"].endswith("''bundle_nameless.relight.zip")
    assert zipfile.ZipFile(io.BytesIO(answer.content)).read("manifest.json") == b"{}"
