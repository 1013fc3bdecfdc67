"""Slow and oversized requests against the real HTTP server, by plain sockets."""

import contextlib
import json
import socket
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from urllib.parse import urlsplit

import httpx2
import pytest
from support.live_server import LiveServer

pytestmark = pytest.mark.slow
SLOW = {"header_timeout_s": 1.0, "body_window_s": 1.0, "max_json_bytes": 2000}


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveServer]:
    with LiveServer(tmp_path_factory.mktemp("limits") / "data", **SLOW) as server:
        yield server


@contextlib.contextmanager
def connected(server: LiveServer) -> Iterator[socket.socket]:
    parts = urlsplit(server.url)
    with socket.create_connection((parts.hostname, parts.port), timeout=10) as connection:
        yield connection


def head(server: LiveServer, length: str) -> bytes:
    lines = [
        "POST /v1/scenes HTTP/1.1",
        f"Host: {urlsplit(server.url).netloc}",
        f"Authorization: Bearer {server.key}",
        "Content-Type: application/json",
        length,
    ]
    return "\r\n".join([*lines, "", ""]).encode()


def read_all(connection: socket.socket) -> bytes:
    """Return what comes until the server closes the connection."""
    data = b""
    with contextlib.suppress(ConnectionResetError):
        while chunk := connection.recv(65536):
            data += chunk
    return data


def test_half_open_requests_are_closed_and_the_server_answers_meanwhile(server: LiveServer):
    with contextlib.ExitStack() as stack:
        connections = [stack.enter_context(connected(server)) for _ in range(50)]
        for connection in connections:
            connection.sendall(b"GET /healthz HTTP/1.1\r\nHost: local")
        began = time.monotonic()
        # Before they are closed, which takes a second; the first request of a client loads certificates.
        with httpx2.Client(verify=False) as client:
            assert client.get(f"{server.url}/healthz").status_code == 200
        assert time.monotonic() - began < 1.0
        for connection in connections:
            read_all(connection)
        assert time.monotonic() - began < 6


def test_bodies_that_drip_are_ended_with_a_408(server: LiveServer):
    with contextlib.ExitStack() as stack:
        connections = [stack.enter_context(connected(server)) for _ in range(20)]
        for connection in connections:
            connection.sendall(head(server, "Content-Length: 1000") + b'{"na')
        began = time.monotonic()
        for connection in connections:
            answer = read_all(connection)
            assert answer.startswith(b"HTTP/1.1 408")
            assert json.loads(answer.partition(b"\r\n\r\n")[2])["code"] == "body_too_slow"
        assert time.monotonic() - began < 8


def test_a_body_that_is_announced_as_too_large_is_refused_unread_and_the_connection_closed(
    server: LiveServer,
):
    with connected(server) as connection:
        connection.sendall(head(server, "Content-Length: 1000000000"))
        began = time.monotonic()
        answer = read_all(connection)
    assert answer.startswith(b"HTTP/1.1 413")
    assert b"connection: close" in answer.lower()
    assert time.monotonic() - began < 1.0


def test_a_body_without_length_is_cut_off_at_the_limit(server: LiveServer):
    with connected(server) as connection:
        connection.sendall(head(server, "Transfer-Encoding: chunked"))
        with contextlib.suppress(ConnectionError):
            for _ in range(5):
                connection.sendall(b"3e8\r\n" + b"x" * 1000 + b"\r\n")
        answer = read_all(connection)
    assert answer.startswith(b"HTTP/1.1 413")


def test_a_thousand_slow_logins_and_a_thousand_idle_streams_harm_nobody(server: LiveServer):
    """Each kind more than the 128 connections at which Granian stops by itself, from one client."""
    host = f"Host: {urlsplit(server.url).netloc}\r\n"
    slow = f"POST /v1/login HTTP/1.1\r\n{host}Content-Length: 200\r\n\r\n{{".encode()
    idle = f"GET /v1/events HTTP/1.1\r\n{host}Authorization: Bearer {server.key}\r\n\r\n".encode()
    for request in (slow, idle):
        with contextlib.ExitStack() as stack:
            for _ in range(1000):
                stack.enter_context(connected(server)).sendall(request)
            seconds = [answer_time(f"{server.url}/healthz") for _ in range(10)]
            seconds += [answer_time(f"{server.url}/v1/jobs", server.key) for _ in range(10)]
            # A server that is full answers none of them in the ten seconds that they have.
            assert max(seconds) < 5.0


def test_a_client_that_holds_all_connections_it_can_leaves_some_to_others(tmp_path: Path):
    """Without a word on any: Granian knows no limit for one client."""
    small = {"max_connections": 200, "max_streams": 50, "max_bodies": 50, "max_requests": 50}
    # Long enough that it is not the time-out that makes room.
    with LiveServer(tmp_path / "data", header_timeout_s=60.0, **small) as server, ExitStack() as stack:
        parts = urlsplit(server.url)
        for _ in range(400):
            held = stack.enter_context(socket.socket())
            held.settimeout(0.2)
            held.bind(("127.0.0.9", 0))
            with contextlib.suppress(TimeoutError):
                held.connect((parts.hostname, parts.port))
        assert max(answer_time(f"{server.url}/healthz") for _ in range(5)) < 8.0
        assert server.client.get("/v1/jobs").status_code == 200
        lines = server.client.get("/metrics").text.splitlines()
        (closed,) = [line for line in lines if line.startswith("lambent_connections_closed_total")]
        assert float(closed.split()[1]) > 50


def test_a_client_behind_a_trusted_proxy_is_known_by_the_address_that_the_proxy_names(tmp_path: Path):
    limits = {"max_streams": 8, "trusted_proxies": "127.0.0.1", "stream_ping_s": 5.0}
    with LiveServer(tmp_path / "data", **limits) as server, ExitStack() as stack:

        def status(client: str) -> int:
            headers = {"X-Forwarded-For": client}
            return stack.enter_context(server.client.stream("GET", "/v1/events", headers=headers)).status_code

        assert [status("10.0.0.1"), status("10.0.0.1")] == [200, 200]
        refused = server.client.get("/v1/events", headers={"X-Forwarded-For": "10.0.0.1"})
        assert (refused.status_code, refused.json()["quota"]["of"]) == (429, "address")
        # Another address, but the same key.
        refused = server.client.get("/v1/events", headers={"X-Forwarded-For": "10.0.0.2"})
        assert (refused.status_code, refused.json()["quota"]["of"]) == (429, "key")


def answer_time(url: str, key: str = "") -> float:
    began = time.monotonic()
    headers = {"Authorization": f"Bearer {key}"} if key else {}
    assert httpx2.get(url, headers=headers, timeout=10.0, verify=False).status_code == 200
    return time.monotonic() - began


def test_noise_is_no_request_and_harms_nobody(server: LiveServer):
    for noise in (b"\x16\x03\x01\x02\x00\x01", b"GET\r\n\r\n", b"\0" * 1000, b"A" * 500_000 + b"\r\n\r\n"):
        with connected(server) as connection:
            with contextlib.suppress(OSError):
                connection.sendall(noise)
                connection.shutdown(socket.SHUT_WR)
            read_all(connection)
    assert httpx2.get(f"{server.url}/healthz").status_code == 200


def test_an_upload_that_breaks_off_leaves_nothing(server: LiveServer):
    scene_id = server.client.post("/v1/scenes", json={"name": "x"}).json()["id"]
    with connected(server) as connection:
        text = head(server, "Content-Length: 5000").replace(
            b"POST /v1/scenes ", f"PUT /v1/scenes/{scene_id}/archive ".encode()
        )
        connection.sendall(text + b"PK\x03\x04")
        time.sleep(0.3)
    time.sleep(0.5)
    assert list((server.data / "scratch").iterdir()) == []
    assert server.client.get(f"/v1/scenes/{scene_id}").json()["state"] == "open"
