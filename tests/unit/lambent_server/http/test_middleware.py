"""The layer around every request: identity, origin and size."""

import gzip
import json
from pathlib import Path
from typing import Any

import lambent_pages
import pytest
from httpx2 import Request
from lambent_server.app import describe
from lambent_server.database.cluster_schema import login_codes
from lambent_server.database.schema import api_keys
from lambent_server.database.tenancy import add, rows
from lambent_server.http import identity, middleware
from lambent_server.http.budget import Budget
from lambent_server.http.identity import COOKIE, issue_login_code, redeem_login_code
from sqlalchemy.exc import OperationalError
from starlette.responses import Response
from starlette.testclient import TestClient
from support.api import KEY, STRANGER_KEY, TENANT, Api, expect, expect_problem, opened, served, sha256

CSRF = {"x-lambent-csrf": "1"}

# Those who sign in have not said who they are.
PUBLIC = ("/v1/login", "/v1/sign-in", "/v1/sign-in/callback")


api = served(scope="module", max_json_bytes=2000)


def log_in(api: Api):
    """Return a browser's client: no key, a cookie."""
    code = api.login_code()
    browser = api.other(None)
    expect(browser.post("/v1/login", json={"code": code}), 204)
    return browser


def test_without_a_key_nothing_but_the_public_pages_answers(api: Api):
    nobody = api.other(None)
    for path, operations in describe()["paths"].items():
        for method in operations:
            url = path.replace("{scene_id}", "x").replace("{job_id}", "x").replace("{bundle_id}", "x")
            url = url.replace("{share_id}", "x").replace("{key_id}", "x").replace("{environment_id}", "x")
            url = url.replace("{path}", "x").replace("{sha256}", "0" * 64)
            answer = nobody.request(method, url, json={} if path == "/v1/login" else None)
            if path in ("/healthz", "/readyz", "/v1/version", "/v1/provenance-key"):
                assert answer.status_code == 200
            elif path not in PUBLIC:
                expect_problem(answer, 401, "not_authenticated")
                assert answer.headers["www-authenticate"].startswith("Bearer")


def test_streams_of_one_key_are_looked_up_together(api: Api, monkeypatch: pytest.MonkeyPatch):
    asked: list[str] = []

    def who_of_key(services: Any, key: str) -> Any:
        asked.append(key)
        return identity.who_of_key(services, key)

    async def stream(scope: Any, receive: Any, send: Any) -> None:
        for _ in range(3):
            assert scope["state"]["identify"]().tenant == scope["state"]["tenant"]
        await Response()(scope, receive, send)

    monkeypatch.setattr(middleware, "who_of_key", who_of_key)
    services = api.services
    gate = middleware.Gate(stream, services, frozenset({"localhost"}), "x", Budget(services.settings))
    for key in (KEY, KEY, STRANGER_KEY):
        client = TestClient(gate, base_url="http://localhost", headers={"Authorization": f"Bearer {key}"})
        assert client.get("/v1/jobs").status_code == 200
    # Each request for itself, and the streams of each key once.
    assert asked == [KEY, KEY, KEY, STRANGER_KEY, STRANGER_KEY]


def test_a_wrong_key_does_not_get_in(api: Api):
    for key in ("", " ", "x", KEY[:-1], KEY + "x"):
        expect_problem(api.other(key).get("/v1/jobs"), 401, "not_authenticated")


def test_an_empty_key_is_never_valid_even_where_its_hash_is_stored(api: Api):
    with api.services.database.write() as connection:
        values = {"id": "key_empty", "name": "empty", "key_sha256": sha256(b""), "created_at": 0.0}
        connection.execute(add(TENANT, api_keys, **values))
    expect_problem(api.other("").get("/v1/jobs"), 401, "not_authenticated")


def test_an_address_that_cannot_be_read_is_a_400(api: Api):
    expect_problem(api.other(None).get("/v1/jobs", headers={"host": "["}), 400, "header_invalid")
    origin = {**CSRF, "origin": "http://["}
    expect_problem(log_in(api).post("/v1/scenes", json={}, headers=origin), 400, "header_invalid")


def test_a_body_that_is_no_json_has_the_code_that_is_documented(api: Api):
    for content in (b"{", b"\xff", b'{"name": "\xff"}'):
        answer = api.post("/v1/scenes", content=content, headers={"content-type": "application/json"})
        expect_problem(answer, 400, "invalid_json")


def test_logging_out_ends_the_session_and_no_other(api: Api):
    browser, other = log_in(api), log_in(api)
    expect_problem(browser.post("/v1/logout"), 403, "csrf")
    answer = browser.post("/v1/logout", headers=CSRF)
    assert answer.status_code == 204
    token = answer.request.headers["cookie"].partition("=")[2]
    expect_problem(browser.get("/v1/jobs"), 401, "not_authenticated")
    stolen = api.other(None).get("/v1/jobs", headers={"cookie": f"{COOKIE}={token}"})
    expect_problem(stolen, 401, "not_authenticated")
    expect(other.get("/v1/jobs"), 200)


def test_only_a_hash_of_the_key_is_stored(api: Api):
    for path in api.services.settings.data.glob("lambent.sqlite*"):
        assert KEY.encode() not in path.read_bytes()


def test_a_foreign_host_name_is_refused(api: Api):
    for host in ("evil.example", "localhost.evil.example", "127.0.0.1.nip.io:80"):
        expect_problem(api.get("/v1/jobs", headers={"host": host}), 421, "host_not_allowed")
    for host in ("localhost:1234", "127.0.0.1", "[::1]:80"):
        expect(api.get("/v1/jobs", headers={"host": host}), 200)


def test_a_request_names_exactly_one_host(api: Api):
    expect_problem(api.get("/v1/jobs", headers={"host": ""}), 400, "header_invalid")
    two = [("host", "localhost"), ("host", "localhost")]
    for other in ("localhost", "evil.example"):
        headers = [("authorization", f"Bearer {KEY}"), two[0], ("host", other)]
        request = Request("GET", "http://localhost/v1/jobs", headers=headers)
        assert len(request.headers.get_list("host")) == 2
        problem = expect_problem(api.client.send(request), 400, "header_invalid")
        assert "2 Host headers" in problem["detail"]
    for host in ("evil@localhost", "localhost/evil", "localhost:x", "localhost:999999", "[::1", "localhost?"):
        expect_problem(api.get("/v1/jobs", headers={"host": host}), 400, "header_invalid")


def test_text_that_nothing_can_store_is_refused_before_anybody_is_asked_for_a_key(api: Api):
    nobody = api.other(None)
    for path in ("/embed/%00", "/embed/%00/picture", "/v1/jobs/%ff", "/v1/jobs/%ed%a0%80", "/%0a", "/%7f"):
        assert expect_problem(nobody.get(path), 400, "target_invalid")["errors"][0]["pointer"] == "#/path"
    for query in ("q=%00", "label=a%3D%ff", "%00=1"):
        assert "query" in expect_problem(api.get(f"/v1/jobs?{query}"), 400, "target_invalid")["detail"]


def test_a_login_code_works_once_and_gives_a_cookie_scripts_cannot_read(api: Api):
    code = api.login_code()
    browser = api.other(None)
    answer = browser.post("/v1/login", json={"code": code})
    assert answer.status_code == 204
    cookie = answer.headers["set-cookie"].lower()
    assert "httponly" in cookie
    assert "samesite=strict" in cookie
    expect(browser.get("/v1/jobs"), 200)
    expect_problem(api.other(None).post("/v1/login", json={"code": code}), 401, "login_code_invalid")
    expect_problem(api.other(None).post("/v1/login", json={"code": "x"}), 401, "login_code_invalid")


def test_a_login_code_ends(api: Api, monkeypatch: pytest.MonkeyPatch):
    with api.services.database.write() as connection:
        code, until = issue_login_code(connection, TENANT, 60.0)
        monkeypatch.setattr("lambent_server.http.identity.now", lambda: until + 1)
        assert redeem_login_code(connection, code) is None


def test_a_login_code_is_used_up_only_with_the_session_that_it_gives(
    api: Api, monkeypatch: pytest.MonkeyPatch
):
    code, browser = api.login_code(), api.other(None)

    def fail(*_: Any, **__: Any) -> Any:
        raise OSError("the machine is about to die")

    with monkeypatch.context() as patched:
        patched.setattr("lambent_server.people.login_routes.open_session", fail)
        expect_problem(browser.post("/v1/login", json={"code": code}), 500, "internal")
    expect(browser.post("/v1/login", json={"code": code}), 204)


def test_no_login_link_without_its_entry_in_the_audit_log(api: Api, monkeypatch: pytest.MonkeyPatch):
    def codes() -> int:
        with api.services.database.read() as connection:
            return len(connection.execute(rows(TENANT, login_codes)).all())

    def fail(*_: Any, **__: Any) -> Any:
        raise OSError("the machine is about to die")

    before = codes()
    with monkeypatch.context() as patched:
        patched.setattr("lambent_server.people.login_routes.audit.record", fail)
        expect_problem(api.post("/v1/login-links"), 500, "internal")
    assert codes() == before


def test_a_browser_writes_only_with_the_header_and_from_this_site(api: Api):
    browser = log_in(api)
    body = {"name": "x"}
    expect_problem(browser.post("/v1/scenes", json=body), 403, "csrf")
    expect(browser.post("/v1/scenes", json=body, headers=CSRF), 201)
    expect(browser.post("/v1/scenes", json=body, headers={**CSRF, "origin": "http://localhost"}), 201)
    foreign = {**CSRF, "origin": "http://evil.example"}
    expect_problem(browser.post("/v1/scenes", json=body, headers=foreign), 403, "csrf")
    expect_problem(browser.post("/v1/scenes", json=body, headers={**CSRF, "origin": "null"}), 403, "csrf")
    # A key is not sent by browsers on their own.
    expect(api.post("/v1/scenes", json=body), 201)


def test_a_session_ends(api: Api, monkeypatch: pytest.MonkeyPatch):
    browser = log_in(api)
    expect(browser.get("/v1/jobs"), 200)
    later = api.services.settings.session_s + 10
    import time

    monkeypatch.setattr("lambent_server.http.identity.now", lambda: time.time() + later)
    expect_problem(browser.get("/v1/jobs"), 401, "not_authenticated")


def test_a_made_up_cookie_does_not_get_in(api: Api):
    for value in ("x", "", '"', "\u00e4"):
        cookie = f"{COOKIE}={value}".encode()
        answer = api.other(None).get("/v1/jobs", headers={b"cookie": cookie})
        expect_problem(answer, 401, "not_authenticated")


def test_every_answer_carries_the_strict_headers(api: Api):
    for path in ("/", "/v1/jobs", "/nothing", "/assets/nothing.js"):
        headers = api.get(path).headers
        assert "default-src 'none'" in headers["content-security-policy"], path
        assert "unsafe" not in headers["content-security-policy"]
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["x-request-id"].startswith("req_")
        assert "access-control-allow-origin" not in headers


def test_a_body_over_the_limit_is_refused_before_it_is_read(api: Api):
    read: list[bytes] = []

    def body():
        for _ in range(10):
            read.append(b"x" * 1000)
            yield read[-1]

    answer = api.post("/v1/scenes", content=json.dumps({"name": "x" * 3000}))
    expect_problem(answer, 413, "body_too_large")
    assert answer.headers["connection"] == "close"
    # One that does not say how long it is, is cut off when it is too long.
    answer = api.post("/v1/scenes", content=body(), headers={"content-type": "application/json"})
    expect_problem(answer, 413, "body_too_large")


def test_unknown_paths_and_methods_are_problems(api: Api):
    expect_problem(api.get("/v1/nothing"), 404, "route_not_found")
    answer = api.delete("/v1/jobs")
    expect_problem(answer, 405, "method_not_allowed")
    assert answer.headers["allow"]
    expect_problem(api.get("/v1/jobs/x:cancel"), 405, "method_not_allowed")


def test_bytes_that_another_tenant_has_are_to_be_sent_again(api: Api):
    """That they are known would say something about others."""
    api.scene()
    stranger = api.other(STRANGER_KEY)
    mine = expect(stranger.post("/v1/scenes", json={"name": "x"}), 201)["id"]
    plan = [{"path": "a.png", "size": 2, "sha256": sha256(b"{}")}]
    assert expect(stranger.post(f"/v1/scenes/{mine}/files:plan", json=plan), 200)["missing"] == [
        sha256(b"{}")
    ]


def test_a_database_that_is_away_is_a_503_and_a_mistake_is_a_500_without_details(
    api: Api, monkeypatch: pytest.MonkeyPatch
):
    def away(*_: object, **__: object) -> None:
        raise OperationalError("SELECT secret", {}, Exception("gone"))

    def broken(*_: object, **__: object) -> None:
        raise RuntimeError("secret path /root")

    job = api.job()
    for failing, status, code in ((away, 503, "database_unavailable"), (broken, 500, "internal")):
        monkeypatch.setattr("lambent_server.jobs.queries.require_job", failing)
        problem = expect_problem(api.get(f"/v1/jobs/{job['id']}"), status, code)
        assert problem["retryable"]
        assert "secret" not in json.dumps(problem)


def test_the_server_says_what_it_is_and_accepts(api: Api):
    assert expect(api.get("/v1/version"), 200)["api"] == "v1"
    limits = expect(api.get("/v1/limits"), 200)
    assert limits["max_json_bytes"] == 2000
    assert ".png" in limits["scene_suffixes"]
    presets = expect(api.get("/v1/presets"), 200)
    assert presets["default"] in [each["name"] for each in presets["items"]]
    assert expect(api.get("/readyz"), 200)["status"] == "ok"
    assert expect(api.get("/openapi.json"), 200) == describe()
    assert "lambent_jobs" in api.get("/metrics").text


def test_the_pages_are_sent_to_anybody_and_asked_for_again_by_their_etag(
    api: Api, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    (tmp_path / "assets").mkdir()
    for name in ("jobs.html", "viewer.html", "assets/jobs-1a2b.js", "assets/refineWorker-1a2b.js"):
        (tmp_path / name).write_text(name)
    find = lambent_pages.find
    monkeypatch.setattr("lambent_pages.find", lambda path, **given: find(path, tmp_path, **given))
    monkeypatch.setattr("lambent_pages.are_built", lambda: True)
    nobody = api.other(None)
    start = nobody.get("/")
    assert (start.status_code, start.text) == (200, "jobs.html")
    assert start.headers["cache-control"] == "no-cache"
    assert nobody.get("/", headers={"if-none-match": start.headers["etag"]}).status_code == 304
    assert "immutable" in nobody.get("/assets/jobs-1a2b.js").headers["cache-control"]
    for path, wasm in (("/viewer.html", False), ("/assets/refineWorker-1a2b.js", True)):
        assert ("'wasm-unsafe-eval'" in nobody.get(path).headers["content-security-policy"]) == wasm
    expect_problem(nobody.get("/assets/nothing.js"), 404, "route_not_found")
    expect_problem(nobody.get("/.env.html"), 404, "route_not_found")
    absent = nobody.get("/nothing.html", headers={"accept": "text/html,*/*;q=0.8"})
    assert absent.status_code == 404
    assert absent.headers["content-type"].startswith("text/html")
    assert "There is no such page" in absent.text


def test_pages_are_sent_as_the_build_has_compressed_them(
    api: Api, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    (tmp_path / "jobs.html").write_text("page")
    (tmp_path / "jobs.html.gz").write_bytes(gzip.compress(b"page"))
    find = lambent_pages.find
    monkeypatch.setattr("lambent_pages.find", lambda path, **given: find(path, tmp_path, **given))
    packed = api.other(None).get("/", headers={"accept-encoding": "gzip, deflate"})
    assert packed.headers["content-encoding"] == "gzip"
    assert packed.headers["vary"] == "accept-encoding"
    assert packed.text == "page"
    plain = api.other(None).get("/", headers={"accept-encoding": "identity"})
    assert "content-encoding" not in plain.headers
    assert plain.headers["etag"] != packed.headers["etag"]
    assert plain.text == "page"


def test_pages_that_were_not_built_are_explained(api: Api, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("lambent_pages.find", lambda _path, **_given: None)
    monkeypatch.setattr("lambent_pages.are_built", lambda: False)
    answer = api.other(None).get("/")
    assert answer.status_code == 503
    assert "make pages" in answer.text
    assert answer.headers["content-type"].startswith("text/html")


def test_nobody_signs_in_too_often_from_one_address(tmp_path: Path):
    with opened(tmp_path / "data", sign_ins_per_s=0.5, writes_burst_s=8.0) as api:
        nobody = api.other(None)
        for _ in range(2):
            assert nobody.post("/v1/login", json={"code": "x"}).status_code == 401
        for path in ("/v1/sign-in", "/v1/sign-in/callback"):
            expect_problem(nobody.get(path), 404, "sign_in_not_found")
        problem = expect_problem(nobody.get("/v1/sign-in"), 429, "rate_limited")
        assert problem["quota"] == {"name": "sign_ins_per_s", "of": "address", "limit": 0.5, "used": 0.5}
        assert "signs in or opens links" in problem["detail"]
        # Whoever has signed in already is not affected.
        expect(api.post("/v1/scenes", json={"name": "s"}), 201)
