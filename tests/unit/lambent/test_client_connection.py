"""The connection: problems as exceptions, retries, and who gets the key."""

import json

import httpx2
import pytest
from lambent.connection import Connection
from lambent.errors import RefusedError, ServerFaultError, UnreachableError, UsageProblemError
from lambent.settings import ServerAddress, find_server
from support.fake_server import FakeServer, problem

ADDRESS = ServerAddress(url="http://127.0.0.1:1", api_key="secret")


def connect(handler, pauses=None) -> Connection:
    sleep = pauses.append if pauses is not None else lambda seconds: None
    return Connection(ADDRESS, transport=httpx2.MockTransport(handler), sleep=sleep)


def test_a_problem_becomes_an_exception_with_code_pointers_and_advice():
    errors = [{"pointer": "/params/seed", "message": "must be at least 0"}]
    connection = connect(lambda request: problem(422, "invalid_request", errors=errors, request_id="r1"))
    with pytest.raises(RefusedError) as caught:
        connection.json("POST", "/v1/jobs", json={})
    assert caught.value.code == "invalid_request"
    assert caught.value.errors[0].pointer == "/params/seed"
    assert caught.value.request_id == "r1"
    assert "/params/seed: must be at least 0" in str(caught.value)
    assert caught.value.advice
    assert caught.value.exit_code == 4


@pytest.mark.parametrize(
    ("status", "kind", "exit_code"), [(507, RefusedError, 4), (500, ServerFaultError, 1)]
)
def test_no_room_is_a_refusal_and_a_crash_is_a_fault(status, kind, exit_code):
    with pytest.raises(kind) as caught:
        connect(lambda request: problem(status, "some_code")).json("GET", "/v1/jobs")
    assert caught.value.exit_code == exit_code


def test_an_error_page_that_is_not_a_problem_still_gets_a_code():
    with pytest.raises(RefusedError) as caught:
        connect(lambda request: httpx2.Response(403, text="<html>no</html>")).json("GET", "/v1/jobs")
    assert caught.value.code == "http_403"


def test_a_get_is_tried_again_after_a_lost_connection_with_growing_pauses():
    calls, pauses = [], []

    def handler(request):
        calls.append(request)
        if len(calls) < 3:
            raise httpx2.ConnectError("refused")
        return httpx2.Response(200, json={"ok": True})

    assert connect(handler, pauses).json("GET", "/v1/version") == {"ok": True}
    assert len(calls) == 3
    assert pauses[1] > pauses[0]


def test_a_post_without_a_key_is_never_repeated():
    calls = []

    def handler(request):
        calls.append(request)
        raise httpx2.ReadError("lost")

    with pytest.raises(UnreachableError) as caught:
        connect(handler).json("POST", "/v1/jobs/job_1:retry")
    assert len(calls) == 1
    assert caught.value.exit_code == 3


def test_a_post_with_an_idempotency_key_is_repeated_with_the_same_key():
    keys = []

    def handler(request):
        keys.append(request.headers["Idempotency-Key"])
        return httpx2.Response(503) if len(keys) < 2 else httpx2.Response(202, json={})

    connect(handler).json("POST", "/v1/jobs", headers={"Idempotency-Key": "k"}, json={})
    assert keys == ["k", "k"]


def test_the_pause_the_server_asks_for_is_kept():
    answers = [httpx2.Response(429, headers={"Retry-After": "7"}), httpx2.Response(200, json={})]
    pauses = []
    connect(lambda request: answers.pop(0), pauses).json("GET", "/v1/jobs")
    assert pauses == [7.0]


def test_an_answer_that_is_not_json_says_what_to_check():
    with pytest.raises(Exception, match=r"client\.unexpected_answer.*LAMBENT_URL"):
        connect(lambda request: httpx2.Response(200, text="<html>")).json("GET", "/v1/version")


def test_the_key_is_sent_as_a_bearer_token_and_is_not_in_the_repr():
    server = FakeServer()
    Connection(ADDRESS, transport=server.transport).json("GET", "/v1/jobs")
    assert server.headers[0]["Authorization"] == "Bearer secret"
    assert "secret" not in repr(ADDRESS)


@pytest.fixture
def local_server(tmp_path):
    """Return a data folder as a running local server leaves it."""
    (tmp_path / "server.json").write_text(json.dumps({"url": "http://127.0.0.1:8420/", "pid": 1}))
    (tmp_path / "api.key").write_text("local-key\n")
    return tmp_path


def test_the_local_server_is_found_by_its_files(local_server):
    address = find_server(environ={"LAMBENT_DATA": str(local_server)})
    assert address == ServerAddress(url="http://127.0.0.1:8420", api_key="local-key")


def test_the_local_key_is_not_sent_to_another_server(local_server):
    environ = {"LAMBENT_DATA": str(local_server), "LAMBENT_URL": "https://elsewhere.example"}
    assert find_server(environ=environ) == ServerAddress(url="https://elsewhere.example")


def test_arguments_win_over_the_environment(local_server):
    environ = {"LAMBENT_URL": "http://a:1", "LAMBENT_API_KEY": "b"}
    address = find_server("http://c:2", "d", data=local_server, environ=environ)
    assert address == ServerAddress(url="http://c:2", api_key="d")


def test_without_any_server_the_error_says_how_to_start_one(tmp_path):
    with pytest.raises(UnreachableError, match=r"server\.not_running.*lambent serve"):
        find_server(data=tmp_path, environ={})


def test_an_address_without_a_scheme_is_a_usage_error(tmp_path):
    with pytest.raises(UsageProblemError, match=r"server\.bad_url"):
        find_server("localhost:8420", data=tmp_path, environ={})


def test_a_broken_address_file_is_named(local_server):
    (local_server / "server.json").write_text("{}")
    with pytest.raises(UsageProblemError, match=r"server\.bad_address_file.*server\.json"):
        find_server(data=local_server, environ={})


def stored(request: httpx2.Request) -> httpx2.Response:
    """Answer as a server that sends readers to its store, and as that store."""
    if request.url.host == "store":
        assert "authorization" not in request.headers
        assert "if-range" not in request.headers
        return httpx2.Response(206 if "range" in request.headers else 200, content=b"from the store")
    if request.headers.get("x-lambent-redirect") == "1":
        return httpx2.Response(307, headers={"location": "http://store/blobs/x?signature=y"})
    return httpx2.Response(200, content=b"from the server")


def read(connection: Connection, **headers: str) -> tuple[int, bytes]:
    with connection.stream("/v1/blobs/x", headers=headers, timeout_s=1.0) as response:
        return response.status_code, response.read()


def test_a_file_is_read_from_the_store_which_never_gets_the_key():
    connection = connect(stored)
    assert read(connection) == (200, b"from the store")
    given = {"Range": "bytes=3-", "If-Range": '"x"'}
    assert read(connection, **given) == (206, b"from the store")


@pytest.mark.parametrize("status", [None, 403, 404, 500])
def test_a_store_that_does_not_answer_with_the_file_is_passed_over(status):
    def handler(request: httpx2.Request) -> httpx2.Response:
        if request.url.host == "store":
            if status is None:
                raise httpx2.ConnectError("no route", request=request)
            return httpx2.Response(status, content=b"<Error/>")
        return stored(request)

    assert read(connect(handler)) == (200, b"from the server")


def test_an_answer_elsewhere_that_was_not_asked_for_is_followed_without_the_key():
    def always(request: httpx2.Request) -> httpx2.Response:
        if request.url.host != "store":
            return httpx2.Response(307, headers={"location": "http://store/x"})
        return stored(request)

    assert connect(always).send("GET", "/v1/blobs/x").content == b"from the store"
