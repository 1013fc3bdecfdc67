"""The servers that a run can reach, and the one it talks to: any answers, because they share the state.

Addresses: `unix:/path`, `tls:host:port`, and `tcp:host:port` where an operator has allowed it.
"""

import functools
import json
import os
import random
import threading
import time
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import grpc
from lambent_proto.v1 import worker_pb2, worker_pb2_grpc

RETURN_AFTER_S = 30.0
"""Time after which a run that has changed servers tries its own again."""
_UNIX_OPTIONS = (
    ("grpc.initial_reconnect_backoff_ms", 100),
    ("grpc.min_reconnect_backoff_ms", 100),
    ("grpc.max_reconnect_backoff_ms", 1000),
    ("grpc.enable_http_proxy", 0),
)
_NETWORK_OPTIONS = (
    ("grpc.initial_reconnect_backoff_ms", 500),
    # Also the time that a connection may take.
    ("grpc.min_reconnect_backoff_ms", 5000),
    ("grpc.max_reconnect_backoff_ms", 5000),
    ("grpc.enable_http_proxy", 0),
    # A machine that vanishes closes no connection.
    ("grpc.keepalive_time_ms", 20_000),
    ("grpc.keepalive_timeout_ms", 10_000),
)
_AWAY = frozenset({grpc.StatusCode.UNAVAILABLE, grpc.StatusCode.DEADLINE_EXCEEDED})


class AwayError(Exception):
    """The server at an address that was tried does not know this run: it is another installation."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Identity:
    """Which run this process is, and where its server is."""

    job_id: str
    run: int
    address: str
    token: str
    work_dir: Path
    memory_bytes: int = 0
    """Limit of what the pipeline may allocate; 0 for none."""
    file_bytes: int = 0
    """Limit of the size of a file that it may write; 0 for none."""
    processes: int = 0
    """Limit of its processes and threads; 0 for none."""
    give_up_after_s: float = 0.0
    """Time without a server after which the run ends itself; 0 for never."""
    stop_grace_s: float = 30.0
    """Time that the pipeline has to end when a server says that it must."""
    servers: tuple[str, ...] = ()
    """Addresses of all servers, the nearest first; `address` is that of the one that started the run."""
    authority: str = ""
    """Certificates (PEM) by which servers on other machines are checked; empty: those that gRPC brings."""
    authority_name: str = ""
    """The name in the servers' certificates, if it is not their address."""

    @classmethod
    def from_environment(cls, environment: Mapping[str, str] = os.environ) -> "Identity":
        """Return the identity in `LAMBENT_RUN`."""
        given = json.loads(environment["LAMBENT_RUN"])
        servers = tuple(given.get("servers", ()))
        return cls(**{**given, "work_dir": Path(given["work_dir"]).absolute(), "servers": servers})

    @property
    def fence(self) -> worker_pb2.Fence:
        """Return the fence that every request carries."""
        return worker_pb2.Fence(job_id=self.job_id, run=self.run)


def open_channel(address: str, authority: str = "", authority_name: str = "") -> grpc.Channel:
    """Return a channel to a server; one over TLS trusts `authority` (PEM), or else those that gRPC brings.

    `authority_name` is the name in the server's certificate, if it is not the host of the address.
    """
    kind, _, rest = address.partition(":")
    if kind == "tls":
        credentials = grpc.ssl_channel_credentials(root_certificates=authority.encode() or None)
        named = (("grpc.ssl_target_name_override", authority_name),) if authority_name else ()
        return grpc.secure_channel(rest, credentials, options=(*_NETWORK_OPTIONS, *named))
    if kind == "tcp":
        return grpc.insecure_channel(rest, options=_NETWORK_OPTIONS)
    return grpc.insecure_channel(address, options=_UNIX_OPTIONS)


class Servers:
    """Calls go to the run's own server, or, while that does not answer, to one of the others.

    Safe to use from several threads. A call that fails is not repeated here: the next one goes elsewhere.
    """

    def __init__(self, known: Identity) -> None:
        self._known = known
        self._lock = threading.Lock()
        self._home = known.address
        self._addresses = [known.address]
        self._channels: dict[str, grpc.Channel] = {}
        self._stubs: dict[str, worker_pb2_grpc.WorkerServiceStub] = {}
        self._current = known.address
        self._away_from_home = ""
        """The server that answered last, while the own one is tried again."""
        self._return_at = 0.0
        self.learn(known.servers)

    def __len__(self) -> int:
        return len(self._addresses)

    def __getattr__(self, name: str) -> Any:
        """Return the method `name` of the service, which chooses a server when it is called."""
        if name.startswith("_"):
            raise AttributeError(name)
        return functools.partial(self._invoke, name)

    def learn(self, addresses: Iterable[str]) -> None:
        """Take over the list that a server has sent, the nearest first; an empty one changes nothing."""
        others = [address for address in dict.fromkeys(addresses) if address != self._home]
        if not others:
            return
        # Runs of one machine must not all go to the same server when theirs ends.
        random.shuffle(others)
        others.sort(key=lambda address: not address.startswith("unix:"))
        with self._lock:
            if set(others) != set(self._addresses[1:]):
                self._addresses = [self._home, *others]

    def close(self) -> None:
        """Close all channels."""
        with self._lock:
            for channel in self._channels.values():
                channel.close()

    def _invoke(self, name: str, request: Any, **given: Any) -> Any:
        address, stub = self._choose()
        try:
            answer = getattr(stub, name)(request, **given)
        except grpc.RpcError as error:
            self._note(address, error)
            raise
        return self._pieces(address, answer) if isinstance(answer, Iterator) else answer

    def _pieces(self, address: str, answer: Iterable[Any]) -> Iterator[Any]:
        try:
            yield from answer
        except grpc.RpcError as error:
            self._note(address, error)
            raise

    def _choose(self) -> tuple[str, worker_pb2_grpc.WorkerServiceStub]:
        with self._lock:
            if self._current != self._home and time.monotonic() >= self._return_at:
                self._away_from_home, self._current = self._current, self._home
            address = self._current
            if address not in self._stubs:
                channel = open_channel(address, self._known.authority, self._known.authority_name)
                self._channels[address] = channel
                self._stubs[address] = worker_pb2_grpc.WorkerServiceStub(channel)
            return address, self._stubs[address]

    def _note(self, address: str, error: grpc.RpcError) -> None:
        """Change servers if this one does not answer; raise AwayError if it does not know the run."""
        foreign = error.code() == grpc.StatusCode.UNAUTHENTICATED and address != self._home
        if foreign or error.code() in _AWAY:
            with self._lock:
                self._leave(address)
        if foreign:
            raise AwayError(f"{address} does not know this run") from error

    def _leave(self, address: str) -> None:
        # Another thread may have done so already.
        if address != self._current or len(self._addresses) == 1:
            return
        if address == self._home:
            self._return_at = time.monotonic() + RETURN_AFTER_S * random.uniform(1.0, 1.5)  # noqa: S311
        following = self._away_from_home
        if address != self._home or following not in self._addresses:
            at = self._addresses.index(address) if address in self._addresses else -1
            following = self._addresses[(at + 1) % len(self._addresses)]
        self._current, self._away_from_home = following, ""
