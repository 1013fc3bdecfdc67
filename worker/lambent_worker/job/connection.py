"""The run's line to the server: it survives outages and ends the run when the server has given it up."""

import json
import os
import random
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import grpc
from lambent_proto.v1 import worker_pb2, worker_pb2_grpc

from lambent_worker.files import file_sha256

CHUNK_BYTES = 1024 * 1024
CALL_TIMEOUT_S = 30.0
TRANSFER_TIMEOUT_S = 900.0
FIRST_WAIT_S = 0.1
LONGEST_WAIT_S = 2.0
# After it was asked to end, a run waits this long for a server that does not answer.
FAREWELL_S = 30.0
MAX_BROKEN_TRANSFERS = 5

_FENCED = frozenset(
    {
        grpc.StatusCode.FAILED_PRECONDITION,
        grpc.StatusCode.NOT_FOUND,
        grpc.StatusCode.UNAUTHENTICATED,
        grpc.StatusCode.PERMISSION_DENIED,
    }
)
_WRONG = frozenset({grpc.StatusCode.INVALID_ARGUMENT, grpc.StatusCode.UNIMPLEMENTED})


class FencedError(Exception):
    """The server has started another run, or wants none: this one must end without further calls."""


class RefusedError(Exception):
    """The server refuses the request for good."""


class UnreachableError(Exception):
    """The run was asked to end, or has waited long enough, and the server did not answer any more."""


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
    give_up_after_s: float = 0.0
    """Time without a server after which the run ends itself; 0 for never."""

    @classmethod
    def from_environment(cls, environment: Mapping[str, str] = os.environ) -> "Identity":
        """Return the identity in `LAMBENT_RUN`."""
        given = json.loads(environment["LAMBENT_RUN"])
        return cls(**{**given, "work_dir": Path(given["work_dir"])})

    @property
    def fence(self) -> worker_pb2.Fence:
        """Return the fence that every request carries."""
        return worker_pb2.Fence(job_id=self.job_id, run=self.run)


class Connection:
    """Calls that are tried again until the server answers. Safe to use from several threads."""

    def __init__(self, identity: Identity) -> None:
        self.identity = identity
        self._channel = grpc.insecure_channel(
            identity.address,
            options=[
                ("grpc.initial_reconnect_backoff_ms", 100),
                ("grpc.min_reconnect_backoff_ms", 100),
                ("grpc.max_reconnect_backoff_ms", 1000),
                ("grpc.enable_http_proxy", 0),
            ],
        )
        self.stub = worker_pb2_grpc.WorkerServiceStub(self._channel)
        self._metadata = (("authorization", f"Bearer {identity.token}"),)
        self.ending = threading.Event()

    def close(self) -> None:
        """Close the channel."""
        self._channel.close()

    def once(self, method: Callable[..., Any], request: Any) -> Any:
        """Call once; None where the server does not answer."""
        try:
            return method(request, timeout=CALL_TIMEOUT_S, metadata=self._metadata)
        except grpc.RpcError as error:
            _raise_if_final(error)
            return None

    def call(self, method: Callable[..., Any], request: Any) -> Any:
        """Call until the server answers, however long that takes."""
        return self._persist(lambda: method(request, timeout=CALL_TIMEOUT_S, metadata=self._metadata))

    def _persist(self, attempt: Callable[[], Any]) -> Any:
        wait_s, broken, ending_since = FIRST_WAIT_S, 0, 0.0
        while True:
            try:
                return attempt()
            except grpc.RpcError as error:
                _raise_if_final(error)
                broken += error.code() == grpc.StatusCode.DATA_LOSS
                if broken >= MAX_BROKEN_TRANSFERS:
                    raise RefusedError(f"a file arrived broken {broken} times: {error.details()}") from error
                if self.ending.is_set():
                    ending_since = ending_since or time.monotonic()
                    if time.monotonic() - ending_since > FAREWELL_S:
                        raise UnreachableError(str(error.details())) from error
            time.sleep(wait_s * random.uniform(0.5, 1.0))  # noqa: S311
            wait_s = min(2 * wait_s, LONGEST_WAIT_S)

    def put_file(self, path: Path, media_type: str = "application/octet-stream") -> worker_pb2.PublishedFile:
        """Send a file, which must not change meanwhile, and return its entry."""
        sha256, size = file_sha256(path), path.stat().st_size
        header = worker_pb2.BlobHeader(
            fence=self.identity.fence, sha256=sha256, size_bytes=float(size), media_type=media_type
        )

        def pieces() -> Iterator[worker_pb2.PutBlobRequest]:
            yield worker_pb2.PutBlobRequest(header=header)
            with path.open("rb") as file:
                while chunk := file.read(CHUNK_BYTES):
                    yield worker_pb2.PutBlobRequest(data=chunk)

        self._persist(
            lambda: self.stub.PutBlob(pieces(), timeout=TRANSFER_TIMEOUT_S, metadata=self._metadata)
        )
        return worker_pb2.PublishedFile(
            path=path.name, sha256=sha256, size_bytes=float(size), media_type=media_type
        )

    def get_file(self, sha256: str, target: Path) -> None:
        """Fetch a file; `target` appears only when it is whole and has the hash."""
        if target.exists() and file_sha256(target) == sha256:
            return
        target.parent.mkdir(parents=True, exist_ok=True)
        partial = target.with_name(f"{target.name}.{os.getpid()}.partial")
        request = worker_pb2.GetBlobRequest(fence=self.identity.fence, sha256=sha256)

        def attempt() -> None:
            with partial.open("wb") as file:
                stream = self.stub.GetBlob(request, timeout=TRANSFER_TIMEOUT_S, metadata=self._metadata)
                for message in stream:
                    file.write(message.data)

        self._persist(attempt)
        if file_sha256(partial) != sha256:
            partial.unlink()
            raise RefusedError(f"the server's file {sha256} has another hash")
        partial.replace(target)


def _raise_if_final(error: grpc.RpcError) -> None:
    """Raise for answers that another try would not change."""
    if error.code() in _FENCED:
        raise FencedError(error.details()) from error
    if error.code() in _WRONG:
        raise RefusedError(error.details()) from error
