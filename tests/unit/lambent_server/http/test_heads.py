"""HEAD is answered as GET, without a body, and with the whole of its headers."""

import threading
from pathlib import Path

from lambent_server.app import describe
from support.api import Api, expect_problem, served
from support.one_of_each import one_of_each

# These say something new each time.
CHANGING = ("content-length", "x-request-id", "etag", "date")


api = served(scope="module")


def test_head_has_the_headers_of_get_for_every_operation(api: Api, tmp_path: Path):
    known = {**one_of_each(api, tmp_path), "path": "manifest.json"}
    paths = [path for path, operations in describe()["paths"].items() if "get" in operations]
    for path in paths:
        if path in ("/v1/events", "/v1/sign-in", "/v1/sign-in/callback"):
            continue
        url = path.format(**known)
        head, whole = api.head(url), api.get(url)
        assert (path, head.status_code) == (path, whole.status_code)
        assert head.content == b""
        same = {name: value for name, value in whole.headers.items() if name not in CHANGING}
        assert {name: value for name, value in head.headers.items() if name not in CHANGING} == same, path
        if path not in ("/readyz", "/metrics"):
            assert ("content-length" in head.headers) == ("content-length" in whole.headers), path


def test_pages_answer_head_too(api: Api):
    for path in ("/", "/openapi.json", "/nothing.html"):
        assert api.head(path).status_code == api.get(path).status_code
        assert api.head(path).content == b""


def test_head_of_a_stream_ends(api: Api):
    before = threading.active_count()
    answer = api.head("/v1/events")
    assert (answer.status_code, answer.content) == (200, b"")
    assert answer.headers["content-type"].startswith("text/event-stream")
    assert api.app.state.feed is not None
    assert threading.active_count() <= before + 1


def test_head_of_what_does_not_exist_has_no_body_either(api: Api):
    answer = api.head("/v1/jobs/job_none")
    assert (answer.status_code, answer.content) == (404, b"")
    assert int(answer.headers["content-length"]) > 100


def test_a_path_says_all_its_methods(api: Api):
    for path, methods in {
        "/v1/scenes": "GET, HEAD, POST",
        "/v1/scenes/x": "DELETE, GET, HEAD, PATCH",
        "/v1/login": "POST",
        "/healthz": "GET, HEAD",
    }.items():
        answer = api.put(path, content=b"")
        expect_problem(answer, 405, "method_not_allowed")
        assert answer.headers["allow"] == methods
    assert api.head("/v1/login").headers["allow"] == "POST"
