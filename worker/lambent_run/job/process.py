"""The child of a run process: fetches the scene, checks it, resumes, trains and publishes."""

import re
import signal
import sys
import traceback
from base64 import b64decode
from importlib.metadata import version
from pathlib import Path

from flashcache.errors import ConfigError, ProcessEndedError, TrainingError
from lambent_capture.checks.check_result import CaptureCheck, tell_findings
from lambent_core.errors import (
    IncompleteError,
    InputDamagedError,
    SceneRefusedError,
    Stopped,
    UsageError,
    WorkerError,
)
from lambent_core.reporter import Reporter
from lambent_core.startup import end_with_parent, ranks_in_use
from lambent_proto.v1 import worker_pb2

from lambent_run.job.connection import (
    EXIT_FENCED,
    EXIT_UNREACHABLE,
    Connection,
    FencedError,
    RefusedError,
    UnreachableError,
)
from lambent_run.job.order import Check, Order, Pipeline
from lambent_run.job.run_limits import limit_run
from lambent_run.job.server_reporter import ServerReporter, media_type
from lambent_run.job.servers import Identity
from lambent_run.run.parameters import JobParameters

# How libraries without Python's MemoryError say it: torch, onnxruntime, C++.
_OUT_OF_MEMORY = ("Cannot allocate memory", "Failed to allocate memory", "std::bad_alloc")


def train(order: Order) -> Path:
    """Run the tasks of `lambent_run.run.pipeline` and return the bundle's folder."""
    from lambent_run.run.folder import task_folder
    from lambent_run.run.pipeline import run_pipeline
    from lambent_run.run.spec import RunSpec

    spec = RunSpec.from_job(order.start, order.parameters, order.scene_dir)
    device = order.start.device
    num_ranks = max(1, order.start.gpus) if device.startswith("cuda") else ranks_in_use()
    run_pipeline(spec, order.run_dir, device, order.reporter, checked=order.checked, num_ranks=num_ranks)
    return task_folder(order.run_dir, "export")


def perform(order: Order) -> Path | None:
    """Train, prepare, or adapt a bundle to a light, as the order's kind says; return the bundle's folder.

    None where it makes no bundle.
    """
    if order.start.kind == "prepare":
        from lambent_run.job.prepare import run_prepare

        run_prepare(order)
        return None
    if order.start.kind != "bake":
        return train(order)
    from lambent_run.job.bake import run_bake

    return run_bake(order)


def check(scene_dir: Path) -> CaptureCheck:
    """Return the findings and measurements of a scene."""
    from lambent_capture.checks.check import check_capture

    return check_capture(scene_dir)


def work(pipeline: Pipeline = perform, check: Check = check) -> int:
    """Do the run that `LAMBENT_RUN` names and return the exit code; the server learns how it ended."""
    end_with_parent(signal.SIGKILL)
    identity = Identity.from_environment()
    limit_run(identity)
    connection = Connection(identity)
    try:
        start = connection.call(
            connection.stub.Start,
            worker_pb2.StartRequest(fence=identity.fence, code_version=version("lambent")),
        )
        reporter = ServerReporter(
            connection,
            identity.work_dir,
            code_version=version("lambent"),
            progress_interval_s=start.progress_interval_s,
            preview_interval_s=start.preview_interval_s,
        )
        stop_on_signals(connection, reporter)
        _work(connection, reporter, start, pipeline, check)
    except FencedError as error:
        print(f"fenced: {error}", file=sys.stderr)
        return EXIT_FENCED
    except UnreachableError as error:
        print(f"unreachable: {error}", file=sys.stderr)
        return EXIT_UNREACHABLE
    finally:
        connection.close()
    return 0


def stop_on_signals(connection: Connection, reporter: ServerReporter) -> None:
    """Ask the pipeline to end on SIGTERM and SIGINT, which may come several times."""

    def end(_number: int, _frame: object) -> None:
        connection.ending = True
        reporter.request_stop()

    signal.signal(signal.SIGTERM, end)
    signal.signal(signal.SIGINT, end)


def _work(
    connection: Connection,
    reporter: ServerReporter,
    start: worker_pb2.StartResponse,
    pipeline: Pipeline,
    check: Check,
) -> None:
    """Do the work and tell the server how it ended."""
    fence = connection.identity.fence
    try:
        bundle = _do(connection, reporter, start, pipeline, check)
        if reporter.broken is not None:
            raise reporter.broken
    except (FencedError, UnreachableError):
        raise
    except Exception as error:
        # Whatever ended the pipeline, a server that has given the run up comes first.
        if isinstance(reporter.broken, FencedError | UnreachableError):
            raise reporter.broken from error
        if isinstance(error, Stopped):
            reporter.close()
            outcome = worker_pb2.OUTCOME_STOPPED
            connection.call(connection.stub.Finish, worker_pb2.FinishRequest(fence=fence, outcome=outcome))
            return
        traceback.print_exc()
        request = describe_failure(error)
        request.fence.CopyFrom(fence)
        reporter.close()
        if isinstance(error, IncompleteError):
            request.artifacts.extend(reporter.artifacts)
        connection.call(connection.stub.Fail, request)
        return
    reporter.close()
    if start.kind == "check":
        outcome = worker_pb2.OUTCOME_SUCCEEDED
        connection.call(connection.stub.Finish, worker_pb2.FinishRequest(fence=fence, outcome=outcome))
        return
    files = _send_bundle(connection, bundle) if bundle is not None else []
    published = worker_pb2.PublishRequest(fence=fence, bundle_files=files, artifacts=reporter.artifacts)
    connection.call(connection.stub.Publish, published)


def _do(
    connection: Connection,
    reporter: ServerReporter,
    start: worker_pb2.StartResponse,
    pipeline: Pipeline,
    check: Check,
) -> Path | None:
    identity = connection.identity
    parameters = JobParameters.of(start.params) if start.kind in ("train", "prepare") else JobParameters()
    if start.kind == "prepare":
        from lambent_run.job.prepare import show_kept

        if show_kept(connection, reporter, start, parameters, identity.work_dir):
            return None
    scene_dir = fetch_scene(connection, start, identity.work_dir.parent / "scene")
    checked = None
    if start.check_scene or start.kind == "check":
        checked = check(scene_dir)
        _report_scene(connection, start.scene_name, checked)
        tell_findings(reporter, checked.report.findings)
        if start.kind == "check":
            return None
        if not checked.report.usable:
            raise SceneRefusedError(checked.report)
    restore_checkpoints(connection, reporter, start, identity.work_dir)
    order = Order(
        start=start,
        scene_dir=scene_dir,
        run_dir=identity.work_dir,
        reporter=reporter,
        parameters=parameters,
        checked=checked,
    )
    if start.HasField("render"):
        from lambent_run.job.render import render_pictures

        render_pictures(order)
        return None
    return pipeline(order)


def _report_scene(connection: Connection, name: str, checked: CaptureCheck) -> None:
    """Send the server the report on the scene, with a page where there are measurements."""
    identity = connection.identity
    page_sha256 = ""
    if checked.figures is not None:
        from lambent_capture.checks.limits import CaptureLimits
        from lambent_capture.checks.page import build_page

        path = identity.work_dir / "capture.html"
        path.write_text(build_page(name, checked, CaptureLimits()), encoding="utf-8")
        page_sha256 = connection.put_file(path, "text/html").sha256
    request = worker_pb2.ReportSceneRequest(
        fence=identity.fence,
        report=checked.report,
        figures=checked.figures,
        page_sha256=page_sha256,
        thumbnail_sha256=_send_thumbnail(connection, checked),
    )
    connection.call(connection.stub.ReportScene, request)


def _send_thumbnail(connection: Connection, checked: CaptureCheck) -> str:
    """Send the photograph by which people recognise the scene; return its hash, empty where there is none."""
    if not checked.portrait:
        return ""
    path = connection.identity.work_dir / "thumbnail.jpg"
    path.write_bytes(b64decode(checked.portrait))
    return connection.put_file(path, "image/jpeg").sha256


def fetch_scene(connection: Connection, start: worker_pb2.StartResponse, parent: Path) -> Path:
    """Bring the scene's files here and return their folder, which is named like the scene.

    Raises `InputDamagedError` if the server cannot send one of them as it was.
    """
    folder = parent / (re.sub(r"[^A-Za-z0-9._-]+", "_", start.scene_name).strip("._") or "scene")
    is_scene = not start.HasField("render") and start.kind != "bake"
    for file in start.files:
        try:
            connection.get_file(file.sha256, folder / file.path)
        except RefusedError as error:
            raise InputDamagedError.of(file.path, str(error), is_scene=is_scene) from error
    return folder


def restore_checkpoints(
    connection: Connection, reporter: Reporter, start: worker_pb2.StartResponse, run_dir: Path
) -> None:
    """Bring the kept checkpoints to where the pipeline left them; one that is broken is left out.

    A stage checks itself whether one was made with its present settings.
    """
    for manifest in start.checkpoints:
        try:
            for file in manifest.files:
                connection.get_file(file.sha256, run_dir / file.path)
        except (RefusedError, OSError) as error:
            reporter.log("checkpoint.broken", stage=manifest.stage, step=manifest.step, reason=str(error))
            for file in manifest.files:
                (run_dir / file.path).unlink(missing_ok=True)
            continue
        reporter.log("checkpoint.restored", stage=manifest.stage, step=manifest.step, run=manifest.run)


def _send_bundle(connection: Connection, folder: Path) -> list[worker_pb2.PublishedFile]:
    files = []
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        name = path.relative_to(folder).as_posix()
        sent = connection.put_file(path, media_type(name))
        sent.path = name
        files.append(sent)
    return files


def describe_failure(error: Exception) -> worker_pb2.FailRequest:
    """Return the failure as a request; its cause decides whether and how the job is tried again."""
    code, message = "run.crashed", f"{type(error).__name__}: {str(error)[:500]}; the log has the traceback"
    cause = worker_pb2.FAIL_CAUSE_INTERNAL
    if isinstance(error, WorkerError):
        code, message = error.code, error.message
        if isinstance(error, SceneRefusedError | InputDamagedError):
            cause = worker_pb2.FAIL_CAUSE_BAD_SCENE
        elif isinstance(error, UsageError):
            cause = worker_pb2.FAIL_CAUSE_BAD_CONFIG
    elif isinstance(error, ConfigError):
        cause, code, message = worker_pb2.FAIL_CAUSE_BAD_CONFIG, "config.invalid", str(error)
    elif isinstance(error, TrainingError):
        cause, code, message = worker_pb2.FAIL_CAUSE_DIVERGED, "training.failed", str(error)
    # By name: torch is not imported for a look at an exception.
    elif type(error).__name__ == "OutOfMemoryError":
        cause, code = worker_pb2.FAIL_CAUSE_GPU_OUT_OF_MEMORY, "run.gpu_out_of_memory"
        message = "the GPU has too little memory for this preset; it is tried once with half the rays"
    elif isinstance(error, ProcessEndedError) and error.was_killed:
        cause, code, message = worker_pb2.FAIL_CAUSE_OUT_OF_MEMORY, "run.out_of_memory", str(error)
    elif isinstance(error, MemoryError) or any(words in str(error) for words in _OUT_OF_MEMORY):
        cause, code = worker_pb2.FAIL_CAUSE_OUT_OF_MEMORY, "run.out_of_memory"
        message = (
            "the run needs more memory than the machine has or LAMBENT_RUN_MEMORY_BYTES allows; "
            "take a smaller preset"
        )
    return worker_pb2.FailRequest(cause=cause, code=code, message=message)
