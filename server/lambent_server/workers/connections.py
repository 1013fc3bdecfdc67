"""Connections without a request: fresh, half-open or kept alive. Granian only bounds their total.

It ends each of them after the header time-out; until then, one client could hold all there are. Of the
connections whose request was cut off in its body, Granian leaves about a quarter open: it waits for the rest.
"""

import asyncio
import os
import socket
import stat
import threading
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from ipaddress import ip_address, ip_network
from pathlib import Path
from typing import Any

import structlog

from lambent_server.core.metrics import CONNECTIONS_CLOSED, OPEN_FILES
from lambent_server.http.budget import Budget, client_of_address
from lambent_server.http.request import CUT_OFF, App, Receive, Scope, Send

log = structlog.get_logger()

CHECK_S = 0.5
# Time for the response to a request that was cut off, and for Granian to close its connection.
PARTING_S = 0.5
# The descriptors of this process, on Linux and on macOS.
_DESCRIPTORS = next((path for path in ("/proc/self/fd", "/dev/fd") if Path(path).is_dir()), None)

Peer = tuple[str, int]


class Connections:
    """ASGI middleware that knows which connections have a request, and closes others if they are too many."""

    def __init__(self, app: App, port: int, budget: Budget, trusted: Sequence[str] = ()) -> None:
        """Watch the connections to `port`; addresses in the networks `trusted` may have any number."""
        self._app = app
        self._port = port
        self._limit = budget.max_waiting
        self._limit_of_client = budget.max_waiting_of_client
        self._trusted = [ip_network(each, strict=False) for each in trusted]
        self._lock = threading.Lock()
        self._busy: Counter[Peer] = Counter()
        self._seen: dict[Peer, int] = {}
        self._parting: dict[Peer, float] = {}
        self._round = 0

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        peer = _peer(scope.get("client") or ("", 0))
        state = scope.setdefault("state", {})
        with self._lock:
            self._busy[peer] += 1
        try:
            await self._app(scope, receive, send)
        finally:
            with self._lock:
                self._busy[peer] -= 1
                if self._busy[peer] <= 0:
                    del self._busy[peer]
                if state.get(CUT_OFF):
                    self._parting[peer] = time.monotonic()

    async def watch(self) -> None:
        """Close connections that are too many or were cut off, until cancelled."""
        if _DESCRIPTORS is None:
            log.warning("connections_not_watched", reason="this system does not list open files")
            return
        while True:
            await asyncio.sleep(CHECK_S)
            await asyncio.to_thread(self.check)

    def check(self) -> int:
        """Close the connections that are too many or were cut off; return how many were too many."""
        descriptors = os.listdir(_DESCRIPTORS)
        OPEN_FILES.set(len(descriptors))
        with self._lock:
            busy = frozenset(self._busy)
            due = time.monotonic() - PARTING_S
            parted = {peer for peer, at in self._parting.items() if at <= due}
            for peer in parted:
                del self._parting[peer]
        too_many = len(descriptors) - len(busy) > min(self._limit_of_client, self._limit)
        # Looking at each costs more than counting them, and is rarely needed.
        waiting = self._waiting(descriptors, busy) if parted or too_many else {}
        for peer in parted & waiting.keys():
            self._shut(peer, waiting.pop(peer))
        if not too_many:
            self._seen = {}
            return 0
        self._round += 1
        self._seen = {peer: self._seen.get(peer, self._round) for peer in waiting}
        closed = Counter(self._close(waiting))
        if closed:
            CONNECTIONS_CLOSED.inc(closed.total())
            log.warning("connections_closed", waiting=len(waiting), clients=dict(closed.most_common(5)))
        return closed.total()

    def _waiting(self, descriptors: list[str], busy: frozenset[Peer]) -> dict[Peer, int]:
        """Return the connections without a request, with the descriptor of each."""
        waiting = {}
        for text in descriptors:
            with _opened(int(text)) as connection:
                peer = None if connection is None else _peer_of(connection, self._port)
            if peer is not None and peer not in busy:
                waiting[peer] = int(text)
        return waiting

    def _close(self, waiting: dict[Peer, int]) -> list[str]:
        """Close those that are too many, and return the client of each."""
        by_client: dict[str, list[Peer]] = {}
        for peer in sorted(waiting, key=lambda peer: self._seen[peer]):
            if not self._is_trusted(peer):
                by_client.setdefault(client_of_address(peer[0]), []).append(peer)
        limit = self._limit_of_client
        # Who has most loses first.
        while limit > 1 and sum(min(len(peers), limit) for peers in by_client.values()) > self._limit:
            limit = limit * 3 // 4
        closed = []
        for client, peers in by_client.items():
            closed += [
                client for peer in peers[: max(len(peers) - limit, 0)] if self._shut(peer, waiting[peer])
            ]
        return closed

    def _shut(self, peer: Peer, descriptor: int) -> bool:
        """Close a connection unless it, or its descriptor, has been put to another use meanwhile."""
        with _opened(descriptor) as connection:
            if connection is None or peer in self._busy or _peer_of(connection, self._port) != peer:
                return False
            with suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)
            return True

    def _is_trusted(self, peer: Peer) -> bool:
        return any(ip_address(peer[0]) in network for network in self._trusted)


@contextmanager
def _opened(descriptor: int) -> Iterator[socket.socket | None]:
    """Yield a duplicate of a socket that others own, or None for other files."""
    try:
        connection = None
        if stat.S_ISSOCK(os.fstat(descriptor).st_mode):
            connection = socket.socket(fileno=os.dup(descriptor))
    except OSError:
        # Closed since it was listed.
        connection = None
    try:
        yield connection
    finally:
        if connection is not None:
            connection.close()


def _peer_of(connection: socket.socket, port: int) -> Peer | None:
    """Return the other end of a connection to `port` of this machine, or None for other sockets."""
    if connection.family not in (socket.AF_INET, socket.AF_INET6):
        return None
    try:
        return _peer(connection.getpeername()) if connection.getsockname()[1] == port else None
    except OSError:
        return None


def _peer(address: Sequence[Any]) -> Peer:
    # Granian passes the port as text.
    return str(address[0]), int(address[1])
