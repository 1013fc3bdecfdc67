"""Connections without a request: those of a client that has too many are closed, and no others."""

import asyncio
import os
import socket
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from lambent_server.core.settings import Settings
from lambent_server.http.budget import Budget
from lambent_server.workers.connections import Connections

LOCAL = "127.0.0.1"


class Ends:
    """A listening socket, and both ends of connections to it from any loopback address."""

    def __init__(self) -> None:
        self.listening = socket.create_server((LOCAL, 0), backlog=200)
        self.port = self.listening.getsockname()[1]
        self.accepted: dict[tuple[str, int], socket.socket] = {}
        self.made: list[socket.socket] = []

    def connect(self, address: str, count: int) -> list[socket.socket]:
        made = []
        for _ in range(count):
            client = socket.create_connection((LOCAL, self.port), source_address=(address, 0))
            server, peer = self.listening.accept()
            self.accepted[peer] = server
            made.append(client)
        self.made += made
        return made

    def close(self) -> None:
        for each in [self.listening, *self.accepted.values(), *self.made]:
            each.close()


@pytest.fixture
def ends() -> Iterator[Ends]:
    ends = Ends()
    yield ends
    ends.close()


def watched(
    tmp_path: Path, ends: Ends, *, limit: int, of_client: int, trusted: tuple[str, ...] = ()
) -> Connections:
    async def app(scope: object, receive: object, send: object) -> None:
        await asyncio.sleep(0.3)

    budget = Budget(Settings(data=tmp_path))
    budget.max_waiting, budget.max_waiting_of_client = limit, of_client
    return Connections(app, ends.port, budget, trusted)


def num_open(clients: list[socket.socket]) -> int:
    """Return how many of these connections the server has not closed."""
    count = 0
    for client in clients:
        client.setblocking(False)
        try:
            closed = client.recv(1) == b""
        except BlockingIOError:
            closed = False
        count += not closed
    return count


def test_a_client_with_too_many_loses_its_oldest_and_others_lose_none(tmp_path: Path, ends: Ends):
    connections = watched(tmp_path, ends, limit=100, of_client=10)
    old = ends.connect("127.0.0.2", 12)
    other = ends.connect("127.0.0.3", 8)
    assert connections.check() == 2
    assert (num_open(old), num_open(other)) == (10, 8)
    # The server closes its end when it reads the end of the connection; then there is room for new ones.
    for server in ends.accepted.values():
        server.setblocking(False)
        with suppress(BlockingIOError):
            if server.recv(1) == b"":
                server.close()
    new = ends.connect("127.0.0.2", 5)
    assert connections.check() == 5
    assert (num_open(old), num_open(new), num_open(other)) == (5, 5, 8)


def test_all_clients_together_have_a_limit_and_the_greedy_lose_first(tmp_path: Path, ends: Ends):
    connections = watched(tmp_path, ends, limit=20, of_client=18)
    greedy = ends.connect("127.0.0.2", 18)
    modest = ends.connect("127.0.0.3", 4)
    assert connections.check() > 0
    assert num_open(modest) == 4
    assert num_open(greedy) <= 16


def test_a_connection_with_a_request_is_not_closed(tmp_path: Path, ends: Ends):
    connections = watched(tmp_path, ends, limit=5, of_client=2)
    clients = ends.connect("127.0.0.2", 6)
    # The first ones would be closed first.
    busy = [client.getsockname() for client in clients[2:]]

    async def body() -> None:
        # Granian passes the port as text.
        scopes = [{"client": (host, str(port))} for host, port in busy]
        requests = [asyncio.create_task(connections(scope, None, None)) for scope in scopes]  # type: ignore[arg-type]
        await asyncio.sleep(0.05)
        assert connections.check() == 0
        await asyncio.gather(*requests)

    asyncio.run(body())
    assert num_open(clients) == 6
    assert connections.check() == 4


def test_a_connection_whose_request_was_cut_off_is_closed_once_the_response_had_time(
    tmp_path: Path, ends: Ends, monkeypatch: pytest.MonkeyPatch
):
    async def app(scope: Any, receive: object, send: object) -> None:
        scope["state"]["cut_off"] = scope["path"] == "/cut"

    connections = Connections(app, ends.port, Budget(Settings(data=tmp_path)))
    cut, whole = ends.connect("127.0.0.2", 2)

    async def request(client: socket.socket, path: str) -> None:
        await connections({"client": client.getsockname(), "path": path}, None, None)  # type: ignore[arg-type]

    asyncio.run(request(cut, "/cut"))
    asyncio.run(request(whole, "/whole"))
    assert connections.check() == 0
    assert num_open([cut, whole]) == 2
    monkeypatch.setattr("lambent_server.workers.connections.PARTING_S", 0.0)
    assert connections.check() == 0
    assert (num_open([cut]), num_open([whole])) == (0, 1)


def test_a_trusted_proxy_may_have_any_number(tmp_path: Path, ends: Ends):
    connections = watched(tmp_path, ends, limit=10, of_client=3, trusted=("127.0.0.2/32",))
    proxy, other = ends.connect("127.0.0.2", 30), ends.connect("127.0.0.3", 5)
    assert connections.check() == 2
    assert (num_open(proxy), num_open(other)) == (30, 3)


def test_other_sockets_of_the_process_are_left_alone(tmp_path: Path, ends: Ends):
    connections = watched(tmp_path, ends, limit=1, of_client=1)
    elsewhere = Ends()
    clients = elsewhere.connect("127.0.0.2", 5)
    pair = socket.socketpair()
    ends.connect("127.0.0.2", 3)
    before = Counter(os.listdir("/proc/self/fd"))
    assert connections.check() == 2
    assert num_open(clients) == 5
    assert num_open([pair[0]]) == 1
    # Nothing that was opened to look at them stays open.
    assert len(os.listdir("/proc/self/fd")) == before.total()
    elsewhere.close()
    for each in pair:
        each.close()


def test_few_connections_are_not_even_looked_at(tmp_path: Path, ends: Ends, monkeypatch: pytest.MonkeyPatch):
    connections = watched(tmp_path, ends, limit=10_000, of_client=5000)
    ends.connect("127.0.0.2", 5)
    monkeypatch.setattr(Connections, "_waiting", None)
    assert connections.check() == 0
