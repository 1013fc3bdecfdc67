"""A run and its servers: it continues with any that answers, and returns to its own."""

import contextlib
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import grpc
import pytest
from lambent_proto.v1 import worker_pb2, worker_pb2_grpc
from lambent_run.job import servers
from lambent_run.job.connection import Connection, FencedError, Identity
from lambent_server.cluster.certificates import Certificate, issue, make_authority
from lambent_server.serving import free_port

FENCE = worker_pb2.Fence(job_id="job_x", run=1)
HEARTBEAT = worker_pb2.HeartbeatRequest(fence=FENCE)


@dataclass
class FakeServer(worker_pb2_grpc.WorkerServiceServicer):
    """Counts the heartbeats it gets, and answers as a test says."""

    address: str
    certificate: Certificate | None = None
    code: grpc.StatusCode | None = None
    told: tuple[str, ...] = ()
    calls: int = 0
    server: grpc.Server = field(init=False)

    def __post_init__(self) -> None:
        self.start()

    def start(self) -> None:
        self.server = grpc.server(ThreadPoolExecutor(2))
        worker_pb2_grpc.add_WorkerServiceServicer_to_server(self, self.server)
        rest = self.address.partition(":")[2]
        if self.certificate is not None:
            given = grpc.ssl_server_credentials([(self.certificate.key, self.certificate.chain)])
            self.server.add_secure_port(rest, given)
        else:
            self.server.add_insecure_port(self.address if self.address.startswith("unix:") else rest)
        self.server.start()

    def stop(self) -> None:
        self.server.stop(0).wait()

    def Heartbeat(self, request: object, context: grpc.ServicerContext) -> worker_pb2.HeartbeatResponse:  # noqa: N802
        self.calls += 1
        if self.code is not None:
            context.abort(self.code, "the test wants it so")
        return worker_pb2.HeartbeatResponse(servers=self.told)


@contextlib.contextmanager
def running(*addresses: str, **given: object) -> Iterator[list[FakeServer]]:
    found = [FakeServer(address, **given) for address in addresses]
    try:
        yield found
    finally:
        for each in found:
            each.stop()


@contextlib.contextmanager
def connected(home: str, *others: str, authority: str = "", name: str = "") -> Iterator[Connection]:
    identity = Identity(
        job_id="job_x",
        run=1,
        address=home,
        token="t",
        work_dir=Path(),
        servers=(home, *others),
        authority=authority,
        authority_name=name,
    )
    connection = Connection(identity)
    try:
        yield connection
    finally:
        connection.close()


def beat(connection: Connection) -> object:
    return connection.once(connection.stub.Heartbeat, HEARTBEAT)


def beat_on(connection: Connection) -> None:
    while True:
        beat(connection)


def sockets(folder: Path, *names: str) -> list[str]:
    return [f"unix:{folder}/{name}.sock" for name in names]


def test_a_heartbeat_goes_to_the_next_server_at_once_and_stays_there(tmp_path: Path):
    home, other = sockets(tmp_path, "home", "other")
    with running(home, other) as (first, second), connected(home, other) as connection:
        assert beat(connection) is not None
        assert (first.calls, second.calls) == (1, 0)
        first.stop()
        for _ in range(3):
            assert beat(connection) is not None
        assert second.calls == 3
        second.stop()
        assert beat(connection) is None


def test_a_run_returns_to_its_own_server(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(servers, "RETURN_AFTER_S", 0.2)
    home, other = sockets(tmp_path, "home", "other")
    with running(home, other) as (first, second), connected(home, other) as connection:
        first.stop()
        assert beat(connection) is not None
        time.sleep(0.4)
        # The own server is tried in between, and still away.
        assert beat(connection) is not None
        assert second.calls == 2
        first.start()
        for _ in range(200):
            assert beat(connection) is not None
            if first.calls:
                break
            time.sleep(0.05)
        before = second.calls
        assert beat(connection) is not None
        assert (first.calls, second.calls) == (2, before)


def test_a_server_whose_database_is_away_is_left_for_another(tmp_path: Path):
    home, other = sockets(tmp_path, "home", "other")
    with running(home, other) as (first, second), connected(home, other) as connection:
        first.code = grpc.StatusCode.UNAVAILABLE
        assert beat(connection) is not None
        assert second.calls == 1


def test_what_fences_a_run_does_so_wherever_it_is_said(tmp_path: Path):
    home, other = sockets(tmp_path, "home", "other")
    with running(home, other) as (first, second), connected(home, other) as connection:
        first.stop()
        second.code = grpc.StatusCode.FAILED_PRECONDITION
        with pytest.raises(FencedError):
            beat(connection)


def test_a_stranger_at_an_address_of_before_does_not_end_a_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    # The stranger comes first.
    monkeypatch.setattr(servers.random, "shuffle", lambda _: None)
    home, stranger, other = sockets(tmp_path, "home", "a_stranger", "other")
    with (
        running(home, stranger, other) as (first, second, third),
        connected(home, stranger, other) as connection,
    ):
        second.code = grpc.StatusCode.UNAUTHENTICATED
        first.stop()
        for _ in range(3):
            assert beat(connection) is not None
        assert third.calls == 3
        first.start()
        first.code = grpc.StatusCode.UNAUTHENTICATED
        third.stop()
        with pytest.raises(FencedError):
            beat_on(connection)


def test_servers_that_come_later_are_learnt(tmp_path: Path):
    home, other = sockets(tmp_path, "home", "other")
    with running(home, other) as (first, second), connected(home) as connection:
        first.told = (home, other)
        connection.stub.learn(beat(connection).servers)
        # One that says nothing changes nothing.
        first.told = ()
        connection.stub.learn(beat(connection).servers)
        first.stop()
        assert beat(connection) is not None
        assert second.calls == 1


def test_a_call_is_repeated_elsewhere(tmp_path: Path):
    home, other = sockets(tmp_path, "home", "other")
    with running(home, other) as (first, second), connected(home, other) as connection:
        first.stop()
        assert connection.call(connection.stub.Heartbeat, HEARTBEAT) is not None
        assert second.calls == 1


def test_tls_reaches_servers_of_the_own_authority_only():
    authority, stranger = make_authority(), make_authority()
    address = f"tls:127.0.0.1:{free_port('127.0.0.1')}"
    certificate = issue(authority)
    with running(address, certificate=certificate) as (server,):
        given = {"authority": certificate.authority, "name": certificate.name}
        with connected(address, **given) as connection:
            assert beat(connection) is not None
        with connected(address, authority=issue(stranger).authority, name=certificate.name) as connection:
            assert beat(connection) is None
        with connected(address, authority=certificate.authority, name="another.name") as connection:
            assert beat(connection) is None
        with connected(address.replace("tls:", "tcp:")) as connection:
            assert beat(connection) is None
        assert server.calls == 1
        assert "PRIVATE" not in certificate.authority
