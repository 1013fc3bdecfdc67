"""The gRPC service for run processes; each request is checked against the job's current run."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from errno import EADDRINUSE
from functools import partial, wraps
from typing import Any, NoReturn, TypeVar

import grpc
import structlog
from google.protobuf.message import Message
from lambent_proto.v1 import worker_pb2, worker_pb2_grpc
from sqlalchemy import Connection
from sqlalchemy.exc import SQLAlchemyError

from lambent_server.api.problems import Problem
from lambent_server.cluster.certificates import Certificate
from lambent_server.core.clock import now
from lambent_server.core.secrets import is_token_of
from lambent_server.database.model import JobRow
from lambent_server.database.rows import one
from lambent_server.database.schema import jobs
from lambent_server.database.tenancy import across_tenants
from lambent_server.executors import is_placed, run_name
from lambent_server.jobs.outcomes import requeue, succeed
from lambent_server.jobs.rows import CANCELLING, ENDED, HAS_RUN, SUCCEEDED, owner, set_fields
from lambent_server.services import Services
from lambent_server.storage.content_checks import CHUNK_BYTES
from lambent_server.storage.outages import outage_of
from lambent_server.storage.store import Blob, find_blob
from lambent_server.workers import report_limits
from lambent_server.workers import reports as run_reports
from lambent_server.workers import uploads as worker_uploads
from lambent_server.workers.gate import THREADS, Gatekeeper, Shares

log = structlog.get_logger()

MAX_MESSAGE_BYTES = 8 * 1024 * 1024
MAX_METADATA_BYTES = 16 * 1024
MAX_CALLS = 1024
"""Calls under way, those that wait for a thread among them; others are told to come again."""
Reply = TypeVar("Reply")


class Refused(Exception):  # noqa: N818 (an answer, not a mistake)
    """A request that is answered with a status other than OK."""

    def __init__(self, code: grpc.StatusCode, message: str) -> None:
        super().__init__(message)
        self.code = code


def _abort(context: grpc.ServicerContext, error: Exception) -> NoReturn:
    if isinstance(error, Refused):
        context.abort(error.code, str(error))
    if isinstance(error, worker_uploads.BrokenUploadError):
        context.abort(grpc.StatusCode.DATA_LOSS, str(error))
    if isinstance(error, Problem):
        # The run tries again what another time may bring, such as a full disk.
        code = grpc.StatusCode.UNAVAILABLE if error.retryable else grpc.StatusCode.INVALID_ARGUMENT
        context.abort(code, f"{error.code}: {error.detail}")
    # The run keeps retrying: an unavailable database or a full disk is not its fault.
    problem = outage_of(error)
    if problem is None:
        log.error("worker_request_failed", exc_info=error)
    else:
        log.warning("worker_request_put_off", reason=problem.code, error=type(error).__name__)
    context.abort(grpc.StatusCode.UNAVAILABLE, type(error).__name__)
    raise AssertionError


@contextmanager
def _answering(context: grpc.ServicerContext) -> Iterator[None]:
    """Answer with a status what is refused, and what goes wrong with the database or the disk."""
    try:
        yield
    except (Refused, worker_uploads.BrokenUploadError, Problem, SQLAlchemyError, OSError) as error:
        _abort(context, error)


Act = Callable[["WorkerServicer", Any, Connection, JobRow], Message]


def _of_run(
    *, even_if_ended: bool = False, signal: bool = True
) -> Callable[[Act], Callable[["WorkerServicer", Any, Any], Any]]:
    """Let a method answer a request in one transaction, if it comes from the current run."""

    def decorated(act: Act) -> Callable[["WorkerServicer", Any, Any], Any]:
        @wraps(act)
        def call(self: "WorkerServicer", request: Any, context: Any) -> Any:
            done = partial(act, self, request)
            return self._answer(context, request, done, even_if_ended=even_if_ended, signal=signal)

        return call

    return decorated


class WorkerServicer(worker_pb2_grpc.WorkerServiceServicer):
    """The implementation of the service for run processes."""

    def __init__(
        self,
        services: Services,
        secret: str,
        servers: Callable[[str], Sequence[str]] = lambda _: (),
        shares: Shares | None = None,
    ) -> None:
        """Prepare; `servers` returns where the runs of a host reach the servers."""
        self._shares = shares or Shares.of(services.settings)
        self._services = services
        self._secret = secret
        self._servers = servers

    def _authenticate(self, context: grpc.ServicerContext, fence: worker_pb2.Fence) -> None:
        given = str(dict(context.invocation_metadata()).get("authorization", ""))
        if not is_token_of(self._secret, given.removeprefix("Bearer "), fence.job_id, fence.run):
            raise Refused(grpc.StatusCode.UNAUTHENTICATED, "the token does not belong to this run")

    @staticmethod
    def _current_job(connection: Connection, fence: worker_pb2.Fence) -> JobRow:
        # Locked, so that no other run starts between this check and the end of the transaction.
        statement = across_tenants(jobs).where(jobs.c.id == fence.job_id).with_for_update()
        job = one(connection, statement, JobRow)
        if job is None:
            raise Refused(grpc.StatusCode.NOT_FOUND, f"there is no job {fence.job_id!r}")
        if job.run != fence.run:
            raise Refused(
                grpc.StatusCode.FAILED_PRECONDITION,
                f"run {fence.run} of {fence.job_id} is stale, the current one is {job.run}",
            )
        return job

    @staticmethod
    def _require_active(job: JobRow, fence: worker_pb2.Fence) -> None:
        if job.state not in HAS_RUN:
            raise Refused(
                grpc.StatusCode.FAILED_PRECONDITION,
                f"run {fence.run} of {fence.job_id} has ended, the job is {job.state}",
            )

    def _answer(
        self,
        context: grpc.ServicerContext,
        request: Any,
        act: Callable[[Connection, JobRow], Reply],
        *,
        even_if_ended: bool = False,
        signal: bool = False,
    ) -> Reply:
        """Run `act` in one transaction, if the request comes from the current run.

        A run that reports too much with it fails.
        """
        fence: worker_pb2.Fence = request.fence
        with _answering(context):
            self._authenticate(context, fence)
            with (
                self._shares.timed(fence.job_id, fence.run) as begin,
                self._services.database.write() as connection,
            ):
                begin()
                job = self._current_job(connection, fence)
                if not even_if_ended:
                    self._require_active(job, fence)
                too_much = report_limits.excess(request, job)
                if too_much:
                    report_limits.end(connection, job, too_much, self._services.settings)
                else:
                    reply = act(connection, job)
            if too_much:
                self._services.wakeups.signal()
                raise Refused(grpc.StatusCode.INVALID_ARGUMENT, f"{report_limits.CODE}: {too_much}")
        if signal:
            self._services.wakeups.signal()
        return reply

    def _servers_for(self, job: JobRow) -> Sequence[str]:
        return self._servers((job.handle or {}).get("host", ""))

    @_of_run(signal=False)
    def Register(self, request: Any, connection: Connection, job: JobRow) -> Message:  # noqa: N802
        """Store the handle of the process, in case the server that started it ended before it could."""
        values: dict[str, Any] = {"heartbeat_at": now()}
        handle = job.handle or {}
        if not is_placed(handle):
            run = run_name(job.id, job.run)
            process = {"pid": request.pid, "identity": request.process_identity, "run": run}
            values["handle"] = {"gpus": [], **handle, **process}
        set_fields(connection, job, **values)
        heartbeat_s = self._services.settings.heartbeat_s
        return worker_pb2.RegisterResponse(heartbeat_s=heartbeat_s, servers=self._servers_for(job))

    @_of_run(signal=False)
    def Start(self, request: Any, connection: Connection, job: JobRow) -> Message:  # noqa: N802
        """Return the work to do."""
        set_fields(connection, job, heartbeat_at=now(), progress_at=now())
        return run_reports.describe_run(connection, job, self._services.settings)

    @_of_run(signal=False)
    def Heartbeat(self, request: Any, connection: Connection, job: JobRow) -> Message:  # noqa: N802
        """Record that the process is alive, and tell it whether to stop."""
        set_fields(connection, job, heartbeat_at=now())
        return worker_pb2.HeartbeatResponse(stop=_must_stop(job), servers=self._servers_for(job))

    @_of_run()
    def Report(self, request: Any, connection: Connection, job: JobRow) -> Message:  # noqa: N802
        """Store progress and events; a report that is sent again is stored only once."""
        run_reports.store_report(connection, job, request, self._services.settings)
        return worker_pb2.ReportResponse(stop=_must_stop(job), servers=self._servers_for(job))

    @_of_run()
    def ReportScene(self, request: Any, connection: Connection, job: JobRow) -> Message:  # noqa: N802
        """Store the findings and measurements of the scene."""
        run_reports.store_scene_report(connection, job, request)
        return worker_pb2.ReportSceneResponse()

    def PutBlob(self, request_iterator: Iterator[Any], context: Any) -> Any:  # noqa: N802
        """Store a file of the run, only if it is complete and matches its hash."""
        first = next(request_iterator, None)
        if first is None or not first.HasField("header"):
            _abort(context, Refused(grpc.StatusCode.INVALID_ARGUMENT, "the first message names the blob"))
        header = first.header
        # Check the run first: a stale one must not even fill the disk.
        job = self._answer(context, header, _job_itself)
        with _answering(context):
            created = worker_uploads.receive(self._services, owner(job), header, request_iterator)
            return worker_pb2.PutBlobResponse(created=created)

    def GetBlob(self, request: Any, context: Any) -> Iterator[Any]:  # noqa: N802
        """Send a file that the job's tenant may read."""
        blob = self._answer(context, request, partial(_find_blob, request.sha256))
        with _answering(context):
            for chunk in self._services.store.read(blob.sha256, blob.size_bytes):
                # The store decides the size of its pieces, and the channel limits the size of a message.
                for start in range(0, len(chunk), CHUNK_BYTES):
                    yield worker_pb2.GetBlobResponse(data=chunk[start : start + CHUNK_BYTES])

    def PlanUpload(self, request: Any, context: Any) -> Any:  # noqa: N802
        """Return where to send a file of the run, unless the server has it."""
        job = self._answer(context, request, _job_itself)
        with _answering(context):
            return worker_uploads.plan(self._services, owner(job), request)

    def CompleteUpload(self, request: Any, context: Any) -> Any:  # noqa: N802
        """Take over a file that the run has sent to the store."""
        job = self._answer(context, request, _job_itself)
        with _answering(context):
            return worker_uploads.complete(self._services, owner(job), request)

    def LocateBlob(self, request: Any, context: Any) -> Any:  # noqa: N802
        """Return where to read a file that the job's tenant may read."""
        blob = self._answer(context, request, partial(_find_blob, request.sha256))
        with _answering(context):
            # Not in the transaction: the bytes may have to be read first.
            return worker_pb2.LocateBlobResponse(url=worker_uploads.locate(self._services, blob))

    @_of_run()
    def CommitCheckpoint(self, request: Any, connection: Connection, job: JobRow) -> Message:  # noqa: N802
        """Store a checkpoint as the newest one."""
        run_reports.store_checkpoint(connection, job, request.manifest)
        return worker_pb2.CommitCheckpointResponse()

    @_of_run(even_if_ended=True)
    def Publish(self, request: Any, connection: Connection, job: JobRow) -> Message:  # noqa: N802
        """Publish the result and complete the job; repeating it returns the same answer."""
        if job.state == SUCCEEDED:
            return worker_pb2.PublishResponse(bundle_id=job.bundle_id or "")
        self._require_active(job, request.fence)
        if job.state == CANCELLING:
            raise Refused(grpc.StatusCode.FAILED_PRECONDITION, "the job is being cancelled")
        bundle_id = run_reports.publish(connection, job, request, self._services.store, self._services.signer)
        succeed(connection, job, bundle_id=bundle_id)
        return worker_pb2.PublishResponse(bundle_id=bundle_id or "")

    @_of_run(even_if_ended=True)
    def Finish(self, request: Any, connection: Connection, job: JobRow) -> Message:  # noqa: N802
        """End a run without a bundle."""
        # A requested stop is completed when the process is gone.
        if job.state in HAS_RUN and job.state != CANCELLING and job.stop_reason is None:
            if request.outcome == worker_pb2.OUTCOME_SUCCEEDED:
                succeed(connection, job)
            else:
                requeue(connection, job, "stopped from outside after a checkpoint")
        _note_end(connection, job)
        return worker_pb2.FinishResponse()

    @_of_run(even_if_ended=True)
    def Fail(self, request: Any, connection: Connection, job: JobRow) -> Message:  # noqa: N802
        """End a failed run, and decide whether the job is retried."""
        if job.state in HAS_RUN and job.state != CANCELLING and job.stop_reason is None:
            run_reports.store_failure(connection, job, request, self._services.settings)
        _note_end(connection, job)
        return worker_pb2.FailResponse()


def _job_itself(_: Connection, job: JobRow) -> JobRow:
    return job


def _find_blob(sha256: str, connection: Connection, job: JobRow) -> Blob:
    blob = find_blob(connection, owner(job), sha256)
    if blob is None:
        raise Refused(grpc.StatusCode.NOT_FOUND, f"there is no blob {sha256}")
    return blob


def _note_end(connection: Connection, job: JobRow) -> None:
    """Note that a cancelled run is about to exit, for servers that cannot see its process."""
    if job.state == CANCELLING:
        set_fields(connection, job, stop_reason=ENDED)


def _must_stop(job: JobRow) -> bool:
    return job.state == CANCELLING or job.stop_reason is not None


@dataclass(frozen=True, kw_only=True, slots=True)
class Listening:
    """An address on the network at which run processes of other machines reach the service."""

    address: str
    """Host and port."""
    certificate: Certificate | None
    """None: without TLS."""
    renewed: Callable[[], Certificate | None] = lambda: None
    """Returns the certificate to show from now on, if that is another one."""


def serve_workers(
    services: Services,
    secret: str,
    address: str,
    *,
    network: Listening | None = None,
    servers: Callable[[str], Sequence[str]] = lambda _: (),
) -> grpc.Server:
    """Start the service for run processes at `address` ("unix:/path") and, if asked, on the network.

    `servers` returns where the runs of a host reach the servers. Raises OSError if the address is in use.
    """
    settings = services.settings
    shares = Shares.of(settings)
    server = grpc.server(
        ThreadPoolExecutor(max_workers=THREADS, thread_name_prefix="worker-service"),
        interceptors=[Gatekeeper(secret, shares)],
        maximum_concurrent_rpcs=MAX_CALLS,
        options=[
            ("grpc.max_receive_message_length", MAX_MESSAGE_BYTES),
            ("grpc.max_metadata_size", MAX_METADATA_BYTES),
            ("grpc.so_reuseport", 0),
            # Runs on other machines ask whether the connection still exists.
            ("grpc.http2.min_ping_interval_without_data_ms", 10_000),
        ],
    )
    servicer = WorkerServicer(services, secret, servers, shares)
    worker_pb2_grpc.add_WorkerServiceServicer_to_server(servicer, server)
    server.add_insecure_port(address)
    if network is not None:
        try:
            listen(server, network)
        except RuntimeError as error:
            raise OSError(EADDRINUSE, "it cannot be used", network.address) from error
    server.start()
    return server


def listen(server: grpc.Server, network: Listening) -> None:
    """Let a server answer at an address on the network; raises RuntimeError if that is in use."""
    certificate = network.certificate
    if certificate is None:
        server.add_insecure_port(network.address)
        return
    # Asked at every new connection; the open ones keep what they have seen.
    credentials = grpc.dynamic_ssl_server_credentials(
        _configuration(certificate), lambda: _renewed_configuration(network)
    )
    server.add_secure_port(network.address, credentials)


def _configuration(certificate: Certificate) -> Any:
    return grpc.ssl_server_certificate_configuration([(certificate.key, certificate.chain)])


def _renewed_configuration(network: Listening) -> Any:
    renewed = network.renewed()
    return None if renewed is None else _configuration(renewed)
