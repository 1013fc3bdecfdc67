"""The controller without processes: an executor that does what a test says, and a run that speaks gRPC."""

import contextlib
import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import grpc
import pytest
from lambent_proto.v1 import worker_pb2, worker_pb2_grpc
from lambent_server.cluster.certificates import ServerAddress
from lambent_server.cluster.membership import Membership
from lambent_server.core.secrets import run_token
from lambent_server.database.model import JobRow
from lambent_server.executors import ExecutorAwayError, Gone, Handle, Launch, run_name
from lambent_server.executors.rooms import LocalRoom
from lambent_server.jobs.queries import require_job
from lambent_server.jobs.rows import set_fields
from lambent_server.running.controller import Controller
from lambent_server.workers.service import serve_workers
from support.api import TENANT, Api, opened

SECRET = "secret of the test"


@dataclass
class FakeExecutor:
    """Records its calls; a process ends when the test says so."""

    launches: list[Launch] = field(default_factory=list)
    stops: list[tuple[int, bool]] = field(default_factory=list)
    gone: dict[int, int | None] = field(default_factory=dict)
    broken: bool = False
    slots: int = 1
    max_gpus_: int = 0
    not_placed: str = ""
    away: bool = False
    adopts: bool = False
    known: set[str] = field(default_factory=set)
    forgotten: list[str] = field(default_factory=list)
    runs_elsewhere: bool = False

    def room(self, own: Sequence[Handle], _others: Sequence[Handle]) -> LocalRoom:
        in_use = {gpu for handle in own for gpu in handle.get("gpus", ())}
        return LocalRoom(self.slots - len(own), [g for g in range(self.max_gpus_) if g not in in_use])

    def max_gpus(self) -> int:
        return self.max_gpus_

    def num_places(self) -> int:
        return self.slots

    def start(self, launch: Launch) -> Handle:
        if self.broken:
            raise OSError("no such program")
        self.launches.append(launch)
        run = run_name(launch.job_id, launch.run)
        return {"pid": len(self.launches), "identity": "x", "run": run, "gpus": list(launch.gpus)}

    def sees(self, handle: Handle) -> bool:
        return "pid" in handle and handle.get("host") in (None, "here")

    def poll(self, handle: Handle, *, has_reported: bool = False) -> Gone | None:
        if self.away:
            raise ExecutorAwayError("the cluster does not answer")
        if self.not_placed:
            return Gone(None, self.not_placed)
        return Gone(self.gone[handle["pid"]]) if handle["pid"] in self.gone else None

    def stop(self, handle: Handle, *, force: bool) -> None:
        self.stops.append((handle["pid"], force))

    def adopt(self, handle: Handle) -> bool:
        return self.adopts

    def runs(self) -> frozenset[str]:
        return frozenset(self.known)

    def forget(self, run: str) -> None:
        self.forgotten.append(run)

    def close(self) -> None:
        pass


@dataclass
class Others:
    """A membership of which a test says who else lives."""

    id: str = "server_here"
    host: str = "here"
    leads: bool = True
    controls: bool = True
    is_alone: bool = False
    alive: set[str] = field(default_factory=set)

    def is_alive(self, identifier: str) -> bool:
        """Return whether a server lives."""
        return identifier == self.id or identifier in self.alive

    def endpoints(self, host: str) -> list[str]:
        """Return where run processes of a host reach a server."""
        return [f"tls:{host}:1"]


@dataclass
class Stage:
    """A server without HTTP sockets and processes, and the line a run would use."""

    api: Api
    executor: FakeExecutor
    controller: Controller
    stub: worker_pb2_grpc.WorkerServiceStub
    server: grpc.Server
    address: str

    def start(self, **order: Any) -> str:
        """Return a job that the controller has started."""
        job = self.api.job(**order)
        self.controller.turn()
        assert self.job(job["id"])["state"] == "running"
        return str(job["id"])

    def job(self, job_id: str) -> dict[str, Any]:
        """Return the job."""
        return dict(self.api.get(f"/v1/jobs/{job_id}").json())

    def row(self, job_id: str) -> JobRow:
        """Return the row of the job."""
        with self.api.services.database.read() as connection:
            return require_job(connection, TENANT, job_id)

    def set(self, job_id: str, **values: Any) -> None:
        """Change columns of the job."""
        with self.api.services.database.write() as connection:
            set_fields(connection, self.row(job_id), **values)

    def end(self, exit_code: int | None = None) -> None:
        """End the process that was started last, and let the controller see it."""
        self.executor.gone[len(self.executor.launches)] = exit_code
        self.controller.turn()

    def call(self, method: str, job_id: str, run: int = 1, *, token: str | None = None, **fields: Any) -> Any:
        """Call the worker service as run `run` of a job."""
        fence = worker_pb2.Fence(job_id=job_id, run=run)
        request = getattr(worker_pb2, f"{method}Request")(fence=fence, **fields)
        return getattr(self.stub, method)(request, metadata=metadata(job_id, run, token), timeout=5)

    def put(self, job_id: str, data: bytes, run: int = 1, sha256: str | None = None) -> str:
        """Send a blob as a run and return its hash."""
        digest = sha256 or hashlib.sha256(data).hexdigest()
        fence = worker_pb2.Fence(job_id=job_id, run=run)
        header = worker_pb2.BlobHeader(fence=fence, sha256=digest, size_bytes=len(data))
        messages = [worker_pb2.PutBlobRequest(header=header), worker_pb2.PutBlobRequest(data=data)]
        self.stub.PutBlob(iter(messages), metadata=metadata(job_id, run, None), timeout=5)
        return digest


def token(job_id: str, run: int) -> str:
    """Return the token of a run."""
    return run_token(SECRET, job_id, run)


def metadata(job_id: str, run: int, given: str | None) -> tuple[tuple[str, str], ...]:
    """Return the metadata that authenticates a call as a run's."""
    return (("authorization", f"Bearer {given or token(job_id, run)}"),)


@contextlib.contextmanager
def staged(folder: Path, **settings: Any) -> Iterator[Stage]:
    """Yield a stage on an empty folder."""
    folder.mkdir(parents=True, exist_ok=True)
    with opened(folder / "data", **settings) as api:
        address = f"unix:{folder}/w.sock"
        given = api.services.settings
        executor = FakeExecutor(slots=given.local_slots, max_gpus_=given.local_gpus or 0)
        members = Membership(api.services.database, api.services.settings, host="here", endpoints=(address,))
        controller = Controller(
            api.services, executor, members, secret=SECRET, server_address=ServerAddress(address=address)
        )
        server = serve_workers(api.services, SECRET, address, servers=members.endpoints)
        channel = grpc.insecure_channel(address)
        try:
            yield Stage(
                api, executor, controller, worker_pb2_grpc.WorkerServiceStub(channel), server, address
            )
        finally:
            channel.close()
            server.stop(0).wait()


@contextlib.contextmanager
def refused(code: grpc.StatusCode) -> Iterator[pytest.ExceptionInfo[grpc.RpcError]]:
    """Expect a call to be answered with this status."""
    with pytest.raises(grpc.RpcError) as caught:
        yield caught
    assert caught.value.code() == code, caught.value
