"""Links to one bundle: they read it, and nothing else, until they end or are taken back."""

import contextlib
import time
from collections.abc import Iterator

import pytest
from lambent_server.accounts import organisations
from lambent_server.accounts.shares import bundle_read, find_any, is_active
from lambent_server.core.clock import now
from lambent_server.database.schema import shares as table
from lambent_server.database.tenancy import change
from lambent_server.maintenance.housekeeping import sweep
from support.api import STRANGER, STRANGER_KEY, TENANT, Api, expect, expect_problem, opened
from support.server_rows import add_bundle

MANIFEST = "/v1/bundles/bundle_shown/manifest"
FILES = {"manifest.json": b"{}", "models/cache.onnx": b"cache"}


@pytest.fixture(scope="module")
def api(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Api]:
    with opened(tmp_path_factory.mktemp("api") / "data") as api:
        folder = tmp_path_factory.mktemp("files")
        add_bundle(api, folder, FILES, bundle_id="bundle_shown")
        add_bundle(api, folder, FILES, bundle_id="bundle_other")
        add_bundle(api, folder, FILES, bundle_id="bundle_foreign", tenant=STRANGER)
        yield api


def make(api: Api, **body: object) -> tuple[dict, str]:
    """Return a share of bundle_shown and its token."""
    share = expect(api.post("/v1/bundles/bundle_shown/shares", json=body), 201)
    return share, share["url"].partition("#")[2]


def test_a_link_reads_its_bundle(api: Api):
    share, token = make(api, expires_in_s=3600)
    assert share["url"] == f"http://localhost/embed/{share['id']}#{token}"
    assert token.startswith(f"{share['id']}.")
    browser = api.other(token)
    assert browser.get("/v1/bundles/bundle_shown/files/models/cache.onnx").content == b"cache"
    expect(browser.get(MANIFEST), 200)


def test_a_link_opens_nothing_else(api: Api):
    _, token = make(api)
    job = api.job()
    thief = api.other(token)
    expect(thief.get(MANIFEST), 200)
    for method, path in (
        ("get", "/v1/bundles/bundle_other/manifest"),
        ("get", "/v1/bundles/bundle_other/files/models/cache.onnx"),
        ("get", "/v1/bundles/bundle_foreign/manifest"),
        ("get", "/v1/bundles/bundle_shown"),
        ("get", "/v1/bundles"),
        ("get", "/v1/bundles/bundle_shown/shares"),
        ("post", "/v1/bundles/bundle_shown/shares"),
        ("delete", "/v1/shares/x"),
        ("get", "/v1/scenes"),
        ("get", "/v1/jobs"),
        ("get", f"/v1/jobs/{job['id']}"),
        ("get", "/v1/events"),
        ("post", "/v1/jobs"),
        ("get", "/v1/blobs/" + "0" * 64),
        ("post", "/v1/bundles/bundle_shown/manifest"),
        ("get", "/metrics"),
    ):
        body = {"json": {}} if method == "post" else {}
        answer = thief.request(method, path, headers={"x-lambent-csrf": "1"}, **body)
        expect_problem(answer, 401, "not_authenticated")


def test_a_link_taken_back_is_closed_for_those_who_opened_it(api: Api):
    share, token = make(api)
    browser = api.other(token)
    answer = browser.get(MANIFEST)
    expect(answer, 200)
    # Or the browser would continue showing what it has kept.
    assert answer.headers["cache-control"] == "private, no-cache"
    assert "immutable" in api.get(MANIFEST).headers["cache-control"]
    expect(api.delete(f"/v1/shares/{share['id']}"), 204)
    expect(api.delete(f"/v1/shares/{share['id']}"), 204)
    expect_problem(browser.get(MANIFEST), 401, "not_authenticated")
    listed = expect(api.get("/v1/bundles/bundle_shown/shares"), 200)["items"]
    assert share["id"] not in [each["id"] for each in listed]


def test_a_link_ends(api: Api, monkeypatch: pytest.MonkeyPatch):
    _, token = make(api, expires_in_s=60)
    browser = api.other(token)
    expect(browser.get(MANIFEST), 200)
    monkeypatch.setattr("lambent_server.accounts.shares.now", lambda: time.time() + 61)
    expect_problem(browser.get(MANIFEST), 401, "not_authenticated")


def test_what_a_link_grants_is_signed(api: Api):
    share, token = make(api, expires_in_s=60)
    forged = token[:-1] + ("0" if token[-1] != "0" else "1")
    for wrong in (forged, share["id"], share["id"] + ".", "x", token + "x", token.upper()):
        expect_problem(api.other(wrong).get(MANIFEST), 401, "not_authenticated")
    # Someone who can write rows but does not have the secret gains nothing by them.
    for values in ({"bundle_id": "bundle_other"}, {"expires_at": now() + 1e6}):
        row, mine = make(api)
        with api.services.database.write() as connection:
            connection.execute(change(TENANT, table).where(table.c.id == row["id"]).values(**values))
        expect_problem(api.other(mine).get(MANIFEST), 401, "not_authenticated")


def test_only_the_owner_makes_and_takes_back_links(api: Api):
    share, token = make(api)
    stranger = api.other(STRANGER_KEY)
    expect_problem(stranger.post("/v1/bundles/bundle_shown/shares", json={}), 404, "bundle_not_found")
    expect_problem(stranger.get("/v1/bundles/bundle_shown/shares"), 404, "bundle_not_found")
    expect_problem(stranger.delete(f"/v1/shares/{share['id']}"), 404, "share_not_found")
    expect(api.other(token).get(MANIFEST), 200)
    for seconds in (0, 59, 10**9, "x"):
        answer = api.post("/v1/bundles/bundle_shown/shares", json={"expires_in_s": seconds})
        expect_problem(answer, 422, "invalid_request")


def test_ended_links_are_swept_away(api: Api, monkeypatch: pytest.MonkeyPatch):
    make(api, expires_in_s=60)
    monkeypatch.setattr("lambent_server.maintenance.housekeeping.now", lambda: time.time() + 400 * 24 * 3600)
    sweep(api.services)
    assert expect(api.get("/v1/bundles/bundle_shown/shares"), 200)["items"] == []


def test_a_request_reads_a_bundle_only_by_its_files():
    assert bundle_read("GET", "/v1/bundles/b/files/a/b.png") == "b"
    assert bundle_read("HEAD", "/v1/bundles/b/manifest") == "b"
    for method, path in (
        ("PUT", "/v1/bundles/b/manifest"),
        ("GET", "/v1/bundles/b"),
        ("GET", "/v1/bundles/b/"),
        ("GET", "/v1/bundles/b/shares"),
        ("GET", "/v1/bundles/b/manifest/x"),
        ("GET", "/x/v1/bundles/b/manifest"),
    ):
        assert bundle_read(method, path) is None, path


@contextlib.contextmanager
def closed(api: Api) -> Iterator[None]:
    """Close the organisation for a while."""
    for at in (now(), None):
        with api.services.database.write() as connection:
            organisations.update(connection, TENANT, closed_at=at)
        if at is not None:
            yield


def test_links_of_a_closed_organisation_show_nothing_until_it_is_open_again(api: Api):
    share, token = make(api, expires_in_s=3600)
    visitor = api.other(token)
    page = f"/embed/{share['id']}"
    paths = [f"/v1/bundles/bundle_shown/{name}" for name in ("manifest", "files/models/cache.onnx")]
    assert [visitor.get(path).status_code for path in paths] == [200, 200]
    assert api.other(None).get(page).status_code in (200, 503)
    with closed(api):
        for path in paths:
            expect_problem(visitor.get(path), 401, "not_authenticated")
        answer = api.other(None).get(page)
        assert answer.status_code in (410, 503)
        assert "lambent-bundle" not in answer.text
        assert api.other(None).get(f"{page}/picture").status_code == 404
        with api.services.database.read() as connection:
            row = find_any(connection, share["id"])
        assert row is not None
        assert not is_active(row)
    assert [visitor.get(path).status_code for path in paths] == [200, 200]
