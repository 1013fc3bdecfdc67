"""The gRPC service for run processes; each request is checked against the job's current run."""

import hmac
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NoReturn, TypeVar

import grpc
import structlog
from google.protobuf.message import Message
from lambent_proto.v1 import worker_pb2, worker_pb2_grpc
from sqlalchemy import Connection
from sqlalchemy.exc import SQLAlchemyError

from lambent_server import run_reports
from lambent_server.clock import now
from lambent_server.database.schema import jobs
from lambent_server.database.tenancy import across_tenants
from lambent_server.executors import run_name
from lambent_server.job_rows import CANCELLING, HAS_RUN, SUCCEEDED, Job, owner, set_fields
from lambent_server.outcomes import requeue, succeed
from lambent_server.problems import Problem
from lambent_server.secrets import is_run_token, run_token
from lambent_server.services import Services
from lambent_server.store import CHUNK_BYTES, Blob, find_blob, hash_file

log = structlog.get_logger()

MAX_MESSAGE_BYTES = 8 * 1024 * 1024
Reply = TypeVar("Reply")


class Refused(Exception):  # noqa: N818 (an answer, not a mistake)
    """A request that is answered with a status other than OK."""

    def __init__(self, code: grpc.StatusCode, message: str) -> None:
        super().__init__(message)
        self.code = code


def _abort(context: grpc.ServicerContext, error: Exception) -> NoReturn:
    if isinstance(error, Refused):
        context.abort(error.code, str(error))
    if isinstance(error, Problem):
        context.abort(grpc.StatusCode.INVALID_ARGUMENT, f"{error.code}: {error.detail}")
    # The run keeps retrying: an unavailable database or a full disk is not its fault.
    log.error("worker_request_failed", exc_info=error)
    context.abort(grpc.StatusCode.UNAVAILABLE, type(error).__name__)
    raise AssertionError


class _Gatekeeper(grpc.ServerInterceptor):  # type: ignore[misc]
    """Rejects unauthenticated calls before a thread waits for their data."""

    def __init__(self, secret: str) -> None:
        self._secret = secret

    def intercept_service(self, continuation: Any, details: Any) -> Any:
        """Return the handler of the call."""
        given = str(dict(details.invocation_metadata).get("authorization", ""))
        if is_run_token(self._secret, given.removeprefix("Bearer ")):
            return continuation(details)
        # A stream handler, because other handlers read a message first.
        return grpc.stream_unary_rpc_method_handler(
            lambda _, context: context.abort(grpc.StatusCode.UNAUTHENTICATED, "this is not a token of a run")
        )


class WorkerServicer(worker_pb2_grpc.WorkerServiceServicer):
    """The implementation of the service for run processes."""

    def __init__(self, services: Services, secret: str) -> None:
        self._services = services
        self._secret = secret

    def _authenticate(self, context: grpc.ServicerContext, fence: worker_pb2.Fence) -> None:
        given = dict(context.invocation_metadata()).get("authorization", "")
        expected = f"Bearer {run_token(self._secret, fence.job_id, fence.run)}"
        if not hmac.compare_digest(str(given), expected):
            raise Refused(grpc.StatusCode.UNAUTHENTICATED, "the token does not belong to this run")

    @staticmethod
    def _current_job(connection: Connection, fence: worker_pb2.Fence) -> Job:
        # Locked, so that no other run starts between this check and the end of the transaction.
        statement = across_tenants(jobs).where(jobs.c.id == fence.job_id).with_for_update()
        job = connection.execute(statement).mappings().one_or_none()
        if job is None:
            raise Refused(grpc.StatusCode.NOT_FOUND, f"there is no job {fence.job_id!r}")
        if job["run"] != fence.run:
            raise Refused(
                grpc.StatusCode.FAILED_PRECONDITION,
                f"run {fence.run} of {fence.job_id} is stale, the current one is {job['run']}",
            )
        return dict(job)

    @staticmethod
    def _require_active(job: Job, fence: worker_pb2.Fence) -> None:
        if job["state"] not in HAS_RUN:
            raise Refused(
                grpc.StatusCode.FAILED_PRECONDITION,
                f"run {fence.run} of {fence.job_id} has ended, the job is {job['state']}",
            )

    def _answer(
        self,
        context: grpc.ServicerContext,
        fence: worker_pb2.Fence,
        act: Callable[[Connection, Job], Reply],
        *,
        even_if_ended: bool = False,
        signal: bool = True,
    ) -> Reply:
        """Run `act` in one transaction, if the request comes from the current run."""
        try:
            self._authenticate(context, fence)
            with self._services.database.write() as connection:
                job = self._current_job(connection, fence)
                if not even_if_ended:
                    self._require_active(job, fence)
                reply = act(connection, job)
        except (Refused, Problem, SQLAlchemyError, OSError) as error:
            _abort(context, error)
        if signal:
            self._services.wakeups.signal()
        return reply

    def Register(self, request: Any, context: Any) -> Any:  # noqa: N802
        """Store the handle of the process, in case the server that started it ended before it could."""

        def act(connection: Connection, job: Job) -> Message:
            values: dict[str, Any] = {"heartbeat_at": now()}
            handle = job["handle"] or {}
            if "pid" not in handle:
                run = run_name(job["id"], job["run"])
                found = {"pid": request.pid, "identity": request.process_identity, "run": run}
                values["handle"] = {"gpus": [], **handle, **found}
            set_fields(connection, job, **values)
            return worker_pb2.RegisterResponse(heartbeat_s=self._services.settings.heartbeat_s)

        return self._answer(context, request.fence, act, signal=False)

    def Start(self, request: Any, context: Any) -> Any:  # noqa: N802
        """Return the work to do."""

        def act(connection: Connection, job: Job) -> Message:
            set_fields(connection, job, heartbeat_at=now(), progress_at=now())
            return run_reports.describe_run(connection, job, self._services.settings)

        return self._answer(context, request.fence, act, signal=False)

    def Heartbeat(self, request: Any, context: Any) -> Any:  # noqa: N802
        """Record that the process is alive, and tell it whether to stop."""

        def act(connection: Connection, job: Job) -> Message:
            set_fields(connection, job, heartbeat_at=now())
            return worker_pb2.HeartbeatResponse(stop=_must_stop(job))

        return self._answer(context, request.fence, act, signal=False)

    def Report(self, request: Any, context: Any) -> Any:  # noqa: N802
        """Store progress and events; a report that is sent again is stored only once."""

        def act(connection: Connection, job: Job) -> Message:
            run_reports.store_report(connection, job, request, self._services.settings)
            return worker_pb2.ReportResponse(stop=_must_stop(job))

        return self._answer(context, request.fence, act)

    def ReportScene(self, request: Any, context: Any) -> Any:  # noqa: N802
        """Store the findings and measurements of the scene."""

        def act(connection: Connection, job: Job) -> Message:
            run_reports.store_scene_report(connection, job, request)
            return worker_pb2.ReportSceneResponse()

        return self._answer(context, request.fence, act)

    def PutBlob(self, request_iterator: Iterator[Any], context: Any) -> Any:  # noqa: N802
        """Store a file of the run, only if it is complete and matches its hash."""
        header = next(request_iterator).header
        with tempfile.NamedTemporaryFile(dir=self._services.settings.scratch) as file:

            def act(_connection: Connection, job: Job) -> Job:
                return job

            # Check the run first: a stale one must not even fill the disk.
            job = self._answer(context, header.fence, act, signal=False)
            try:
                for message in request_iterator:
                    file.write(message.data)
                    if file.tell() > header.size_bytes:
                        raise Refused(
                            grpc.StatusCode.INVALID_ARGUMENT,
                            f"{header.size_bytes:.0f} bytes were announced, but more were sent",
                        )
                file.flush()
                if hash_file(Path(file.name)) != header.sha256:
                    raise Refused(grpc.StatusCode.DATA_LOSS, "the bytes do not match the announced hash")
                created = self._services.store.put_file(
                    self._services.database.write,
                    owner(job),
                    Path(file.name),
                    header.sha256,
                    header.media_type or "application/octet-stream",
                )
            except (Refused, SQLAlchemyError, OSError) as error:
                _abort(context, error)
        return worker_pb2.PutBlobResponse(created=created)

    def GetBlob(self, request: Any, context: Any) -> Iterator[Any]:  # noqa: N802
        """Send a file that the job's tenant may read."""

        def act(connection: Connection, job: Job) -> Blob:
            blob = find_blob(connection, owner(job), request.sha256)
            if blob is None:
                raise Refused(grpc.StatusCode.NOT_FOUND, f"there is no blob {request.sha256}")
            return blob

        blob = self._answer(context, request.fence, act, signal=False)
        try:
            for chunk in self._services.store.read(blob.sha256, blob.size_bytes):
                # The store decides the size of its pieces, and the channel limits the size of a message.
                for start in range(0, len(chunk), CHUNK_BYTES):
                    yield worker_pb2.GetBlobResponse(data=chunk[start : start + CHUNK_BYTES])
        except (Problem, OSError) as error:
            _abort(context, error)

    def CommitCheckpoint(self, request: Any, context: Any) -> Any:  # noqa: N802
        """Store a checkpoint as the newest one."""

        def act(connection: Connection, job: Job) -> Message:
            run_reports.store_checkpoint(connection, job, request.manifest)
            return worker_pb2.CommitCheckpointResponse()

        return self._answer(context, request.fence, act)

    def Publish(self, request: Any, context: Any) -> Any:  # noqa: N802
        """Publish the result and complete the job; repeating it returns the same answer."""

        def act(connection: Connection, job: Job) -> Message:
            if job["state"] == SUCCEEDED:
                return worker_pb2.PublishResponse(bundle_id=job["bundle_id"] or "")
            self._require_active(job, request.fence)
            if job["state"] == CANCELLING:
                raise Refused(grpc.StatusCode.FAILED_PRECONDITION, "the job is being cancelled")
            bundle_id = run_reports.publish(connection, job, request, self._services.store)
            succeed(connection, job, bundle_id=bundle_id)
            return worker_pb2.PublishResponse(bundle_id=bundle_id or "")

        return self._answer(context, request.fence, act, even_if_ended=True)

    def Finish(self, request: Any, context: Any) -> Any:  # noqa: N802
        """End a run without a bundle."""

        def act(connection: Connection, job: Job) -> Message:
            # A requested stop is completed when the process is gone.
            if job["state"] in HAS_RUN and job["state"] != CANCELLING and job["stop_reason"] is None:
                if request.outcome == worker_pb2.OUTCOME_SUCCEEDED:
                    succeed(connection, job)
                else:
                    requeue(connection, job, "stopped from outside after a checkpoint")
            return worker_pb2.FinishResponse()

        return self._answer(context, request.fence, act, even_if_ended=True)

    def Fail(self, request: Any, context: Any) -> Any:  # noqa: N802
        """End a failed run, and decide whether the job is retried."""

        def act(connection: Connection, job: Job) -> Message:
            if job["state"] in HAS_RUN and job["state"] != CANCELLING and job["stop_reason"] is None:
                run_reports.store_failure(connection, job, request, self._services.settings)
            return worker_pb2.FailResponse()

        return self._answer(context, request.fence, act, even_if_ended=True)


def _must_stop(job: Job) -> bool:
    return job["state"] == CANCELLING or job["stop_reason"] is not None


def serve_workers(services: Services, secret: str, address: str) -> grpc.Server:
    """Start the service for run processes at `address` ("unix:/path")."""
    server = grpc.server(
        ThreadPoolExecutor(max_workers=16, thread_name_prefix="worker-service"),
        interceptors=[_Gatekeeper(secret)],
        options=[("grpc.max_receive_message_length", MAX_MESSAGE_BYTES), ("grpc.so_reuseport", 0)],
    )
    worker_pb2_grpc.add_WorkerServiceServicer_to_server(WorkerServicer(services, secret), server)
    server.add_insecure_port(address)
    server.start()
    return server
