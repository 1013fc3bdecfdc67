"""The run's line to the server: it survives outages and ends the run when the server has given it up."""

import os
import random
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import grpc
from lambent_core.files import file_sha256
from lambent_proto.v1 import worker_pb2

from lambent_run.job.direct_transfer import Store, StoreAwayError
from lambent_run.job.servers import AwayError, Identity, Servers

CHUNK_BYTES = 1024 * 1024
CALL_TIMEOUT_S = 30.0
# Where another server could answer.
SHORT_TIMEOUT_S = 10.0
TRANSFER_TIMEOUT_S = 900.0
FIRST_WAIT_S = 0.1
LONGEST_WAIT_S = 2.0
# After it was asked to end, a run waits this long for a server that does not answer.
FAREWELL_S = 30.0
MAX_BROKEN_TRANSFERS = 5
EXIT_FENCED = 3
"""Exit code of a run process where another run has taken over: the server needs no word about it."""
EXIT_UNREACHABLE = 4
"""The same where it waited long enough, or was to end, and the server did not answer any more."""

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


class Connection:
    """Calls that are tried again until the server answers. Safe to use from several threads."""

    def __init__(self, identity: Identity) -> None:
        self.identity = identity
        self.stub = Servers(identity)
        self._metadata = (("authorization", f"Bearer {identity.token}"),)
        # Whether the run was asked to end. Handlers of signals set it, so it cannot be an Event: a handler
        # that interrupts another one would wait for ever for the lock which the first one holds.
        self.ending = False
        self._store = Store()

    def close(self) -> None:
        """Close the channels."""
        self.stub.close()
        self._store.close()

    def once(self, method: Callable[..., Any], request: Any) -> Any:
        """Call each server once, until one answers; None where none does."""
        timeout = CALL_TIMEOUT_S if len(self.stub) == 1 else SHORT_TIMEOUT_S
        for _ in range(len(self.stub)):
            try:
                return method(request, timeout=timeout, metadata=self._metadata)
            except AwayError:
                continue
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
            except (grpc.RpcError, StoreAwayError, AwayError) as error:
                details = str(error)
                if isinstance(error, grpc.RpcError):
                    details = str(error.details())
                    _raise_if_final(error)
                    broken += error.code() == grpc.StatusCode.DATA_LOSS
                if broken >= MAX_BROKEN_TRANSFERS:
                    raise RefusedError(f"a file arrived broken {broken} times: {details}") from error
                if self.ending:
                    ending_since = ending_since or time.monotonic()
                    if time.monotonic() - ending_since > FAREWELL_S:
                        raise UnreachableError(details) from error
            time.sleep(wait_s * random.uniform(0.5, 1.0))  # noqa: S311
            wait_s = min(2 * wait_s, LONGEST_WAIT_S)

    def put_file(self, path: Path, media_type: str = "application/octet-stream") -> worker_pb2.PublishedFile:
        """Send a file, which must not change meanwhile, and return its entry."""
        sha256, size = file_sha256(path), path.stat().st_size
        self._persist(lambda: self._put(path, sha256, size, media_type))
        return worker_pb2.PublishedFile(
            path=path.name, sha256=sha256, size_bytes=float(size), media_type=media_type
        )

    def _put(self, path: Path, sha256: str, size: int, media_type: str) -> None:
        """Send a file to the store, or where that cannot be reached from here to the server."""
        fence = self.identity.fence
        planned = worker_pb2.PlanUploadRequest(fence=fence, sha256=sha256, size_bytes=float(size))
        plan = self.stub.PlanUpload(planned, timeout=CALL_TIMEOUT_S, metadata=self._metadata)
        if plan.stored:
            return
        if plan.direct and self._send_parts(path, plan.parts):
            request = worker_pb2.CompleteUploadRequest(
                fence=fence, sha256=sha256, size_bytes=float(size), media_type=media_type
            )
            done = self.stub.CompleteUpload(request, timeout=TRANSFER_TIMEOUT_S, metadata=self._metadata)
            if done.missing:
                raise StoreAwayError("the store has not got everything")
            return
        header = worker_pb2.BlobHeader(
            fence=fence, sha256=sha256, size_bytes=float(size), media_type=media_type
        )

        def pieces() -> Iterator[worker_pb2.PutBlobRequest]:
            yield worker_pb2.PutBlobRequest(header=header)
            with path.open("rb") as file:
                while chunk := file.read(CHUNK_BYTES):
                    yield worker_pb2.PutBlobRequest(data=chunk)

        self.stub.PutBlob(pieces(), timeout=TRANSFER_TIMEOUT_S, metadata=self._metadata)

    def _send_parts(self, path: Path, parts: Iterable[worker_pb2.UploadPart]) -> bool:
        """Send parts of a file; return False if the store never answers to this machine."""
        return all(
            self._reaches(
                self._store.put, path, int(part.offset), int(part.size_bytes), part.url, part.headers
            )
            for part in parts
        )

    def _reaches(self, transfer: Callable[..., None], *given: object) -> bool:
        """Do a transfer; return False if the store never answers to this machine."""
        try:
            transfer(*given)
        except StoreAwayError:
            if self._store.reached:
                raise
            return False
        return True

    def get_file(self, sha256: str, target: Path) -> None:
        """Fetch a file; `target` appears only when it is whole and has the hash."""
        if target.exists() and file_sha256(target) == sha256:
            return
        target.parent.mkdir(parents=True, exist_ok=True)
        partial = target.with_name(f"{target.name}.{os.getpid()}.partial")
        try:
            self._persist(lambda: self._get(sha256, partial))
            if file_sha256(partial) != sha256:
                raise RefusedError(f"the server's file {sha256} has another hash")
        except RefusedError:
            partial.unlink(missing_ok=True)
            raise
        partial.replace(target)

    def _get(self, sha256: str, partial: Path) -> None:
        """Write a file from the store, or where that cannot be reached from here from the server."""
        located = worker_pb2.LocateBlobRequest(fence=self.identity.fence, sha256=sha256)
        location = self.stub.LocateBlob(located, timeout=CALL_TIMEOUT_S, metadata=self._metadata)
        if location.url and self._read(location.url, partial):
            return
        request = worker_pb2.GetBlobRequest(fence=self.identity.fence, sha256=sha256)
        with partial.open("wb") as file:
            for message in self.stub.GetBlob(request, timeout=TRANSFER_TIMEOUT_S, metadata=self._metadata):
                file.write(message.data)

    def _read(self, url: str, partial: Path) -> bool:
        """Read an address of the store; return False if it never answers here, or has no such file."""
        try:
            return self._reaches(self._store.get, url, partial)
        except FileNotFoundError:
            # The server says what is wrong with it.
            return False


def _raise_if_final(error: grpc.RpcError) -> None:
    """Raise for answers that another try would not change."""
    if error.code() in _FENCED:
        raise FencedError(error.details()) from error
    if error.code() in _WRONG:
        raise RefusedError(error.details()) from error
