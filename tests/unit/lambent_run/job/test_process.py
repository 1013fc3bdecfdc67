"""The working part of a run process, against the real worker service in memory."""

import shutil
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from flashcache.errors import ConfigError, ProcessEndedError, TrainingError
from lambent_capture.checks import check
from lambent_capture.checks.check_result import CaptureCheck
from lambent_capture.loading.inspect import inspect_files
from lambent_core.errors import IncompleteError, InputDamagedError, SceneRefusedError, UsageError
from lambent_core.files import file_sha256
from lambent_proto.v1 import job_pb2, scene_pb2, worker_pb2
from lambent_run.job import process
from lambent_run.job.connection import Connection, FencedError, Identity, RefusedError
from lambent_run.job.order import Order
from lambent_run.job.process import describe_failure, fetch_scene, restore_checkpoints
from lambent_run.job.server_reporter import MAX_PREVIEW_BYTES, ServerReporter, media_type
from lambent_run.run import pipeline
from lambent_run.run.spec import read_run
from lambent_run.run.tasks import ingest
from lambent_server.workers.service import serve_workers
from support.captures import write_tensoir
from support.recording_reporter import RecordingReporter
from support.runs import SECRET, Stage, staged, token


@pytest.fixture
def stage(tmp_path: Path) -> Iterator[Stage]:
    with staged(tmp_path / "s", progress_interval_s=0.001) as stage:
        yield stage


def connect(stage: Stage, job: str, run: int = 1) -> Connection:
    folder = stage.api.services.settings.runs / job / f"run-{run}"
    folder.mkdir(parents=True, exist_ok=True)
    return Connection(
        Identity(job_id=job, run=run, address=stage.address, token=token(job, run), work_dir=folder)
    )


@pytest.fixture
def job(stage: Stage) -> str:
    return stage.start(scene_id=stage.api.scene({"a/b.png": b"picture", "a/c.json": b"{}"}))


@pytest.fixture
def connection(stage: Stage, job: str) -> Iterator[Connection]:
    connection = connect(stage, job)
    yield connection
    connection.close()


@pytest.fixture
def reporter(connection: Connection) -> Iterator[ServerReporter]:
    work = connection.identity.work_dir
    reporter = ServerReporter(connection, work, progress_interval_s=0.01, preview_interval_s=0.01)
    yield reporter
    if reporter.broken is None:
        reporter.close()


def stored(stage: Stage, data: bytes) -> Path:
    """Return the file of the store with this content."""
    files = (path for path in (stage.api.services.settings.data / "store").rglob("*") if path.is_file())
    (path,) = [path for path in files if path.read_bytes() == data]
    return path


def until(true: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 10
    while not true():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def save(reporter: ServerReporter, connection: Connection, stage: str, step: int, data: bytes) -> None:
    folder = connection.identity.work_dir / stage / f"step_{step:06d}"
    folder.mkdir(parents=True)
    (folder / "model.safetensors").write_bytes(data)
    reporter.checkpoint(stage, step, folder)


def test_a_checkpoint_comes_back_to_the_same_place_in_the_next_run(
    stage: Stage, job: str, connection: Connection, reporter: ServerReporter
):
    save(reporter, connection, "cache", 10, b"ten")
    save(reporter, connection, "cache", 20, b"twenty")
    reporter.close()
    stage.end(-9)
    second = connect(stage, job, 2)
    start = stage.call("Start", job, 2)
    restore_checkpoints(second, RecordingReporter(), start, second.identity.work_dir)
    found = {path.parent.name: path.read_bytes() for path in second.identity.work_dir.rglob("*.safetensors")}
    assert found == {"step_000010": b"ten", "step_000020": b"twenty"}
    second.close()


def test_a_checkpoint_that_is_broken_in_the_store_is_left_out(
    stage: Stage, job: str, connection: Connection, reporter: ServerReporter
):
    save(reporter, connection, "cache", 10, b"ten")
    save(reporter, connection, "cache", 20, b"twenty")
    stored(stage, b"twenty").write_bytes(b"twentx")
    target = connection.identity.work_dir.parent / "run-2"
    restore_checkpoints(connection, RecordingReporter(), stage.call("Start", job), target)
    assert [path.parent.name for path in target.rglob("*.safetensors")] == ["step_000010"]


def test_the_scene_lies_in_a_folder_of_its_name(
    stage: Stage, job: str, connection: Connection, tmp_path: Path
):
    start = stage.call("Start", job)
    folder = fetch_scene(connection, start, tmp_path / "scene")
    assert folder.name == "a_scene"
    assert (folder / "a" / "b.png").read_bytes() == b"picture"
    # A whole file is not fetched again, a broken one is.
    (folder / "a" / "b.png").write_bytes(b"broken")
    fetch_scene(connection, start, tmp_path / "scene")
    assert (folder / "a" / "b.png").read_bytes() == b"picture"
    assert not list(folder.rglob("*.partial"))


@pytest.mark.parametrize("how", ["flipped", "cut", "gone"])
def test_a_capture_that_is_damaged_in_the_store_is_no_crash(
    stage: Stage, job: str, connection: Connection, tmp_path: Path, how: str
):
    start = stage.call("Start", job)
    path = stored(stage, b"picture")
    path.write_bytes({"flipped": b"pictuse", "cut": b"pic", "gone": b""}[how])
    if how == "gone":
        path.unlink()
    with pytest.raises(InputDamagedError) as caught:
        fetch_scene(connection, start, tmp_path / "scene")
    failure = describe_failure(caught.value)
    assert (failure.code, failure.cause) == ("scene.file_damaged", worker_pb2.FAIL_CAUSE_BAD_SCENE)
    assert failure.message.startswith("a/b.png: ")
    assert "push the same capture again" in failure.message
    start.kind = "bake"
    with pytest.raises(InputDamagedError, match=r"input\.file_damaged"):
        fetch_scene(connection, start, tmp_path / "scene")


def test_what_the_pipeline_tells_arrives_in_order(stage: Stage, job: str, reporter: ServerReporter):
    for step in range(1, 4):
        reporter.progress(job_pb2.Progress(stage="cache", step=step, num_steps=3))
    reporter.log("first", value=1)
    reporter.finding("scene.soft", "take sharper pictures", subject="r_0")
    reporter.preview("view", b"png")
    reporter.preview("view", b"x" * (MAX_PREVIEW_BYTES + 1))
    reporter.close()
    events = stage.api.get(f"/v1/jobs/{job}/events").json()["items"]
    told = [(each["type"], each["name"]) for each in events if each["type"] not in ("state", "progress")]
    assert sorted(told) == [("finding", "r_0"), ("log", ""), ("log", ""), ("preview", "view")]
    assert [each["message"] for each in events if each["type"] == "finding"] == [
        "scene.soft: take sharper pictures"
    ]
    assert stage.job(job)["progress"]["step"] == 3
    (preview,) = [each["sha256"] for each in events if each["type"] == "preview"]
    assert stage.api.get(f"/v1/blobs/{preview}").content == b"png"


def test_a_cancel_reaches_the_pipeline(stage: Stage, job: str, reporter: ServerReporter):
    stage.api.post(f"/v1/jobs/{job}:cancel")
    assert not reporter.should_stop()
    reporter.log("anything")
    until(reporter.should_stop)


def test_a_run_that_was_given_up_stops_and_says_so(stage: Stage, reporter: ServerReporter):
    stage.end(-9)
    reporter.log("anything")
    until(reporter.should_stop)
    with pytest.raises(FencedError, match="stale"):
        reporter.close()


def test_a_call_waits_for_a_server_that_is_away(stage: Stage, job: str, connection: Connection):
    stage.server.stop(0).wait()
    assert connection.once(connection.stub.Heartbeat, heartbeat(connection)) is None
    answers: list[object] = []
    thread = threading.Thread(
        target=lambda: answers.append(connection.call(connection.stub.Heartbeat, heartbeat(connection)))
    )
    thread.start()
    time.sleep(0.3)
    assert answers == []
    server = serve_workers(stage.api.services, SECRET, stage.address)
    thread.join(timeout=20)
    assert answers == [worker_pb2.HeartbeatResponse(stop=False)]
    server.stop(0).wait()


def heartbeat(connection: Connection) -> worker_pb2.HeartbeatRequest:
    return worker_pb2.HeartbeatRequest(fence=connection.identity.fence)


def test_a_request_that_makes_no_sense_is_not_repeated(connection: Connection):
    request = worker_pb2.ReportRequest(
        fence=connection.identity.fence, sequence=1, events=[job_pb2.Event(type="state")]
    )
    with pytest.raises(RefusedError, match="event_type"):
        connection.call(connection.stub.Report, request)


def test_a_file_is_sent_whole_and_once(stage: Stage, connection: Connection, tmp_path: Path):
    path = tmp_path / "weights.bin"
    path.write_bytes(bytes(range(256)) * 20_000)
    sent = connection.put_file(path)
    assert (sent.sha256, sent.size_bytes) == (file_sha256(path), path.stat().st_size)
    assert stage.api.get(f"/v1/blobs/{sent.sha256}").content == path.read_bytes()
    target = tmp_path / "again" / "weights.bin"
    connection.get_file(sent.sha256, target)
    assert target.read_bytes() == path.read_bytes()
    with pytest.raises(FencedError):
        connection.get_file("0" * 64, tmp_path / "none")


@pytest.mark.parametrize(
    ("error", "cause", "code"),
    [
        (ConfigError("x"), "BAD_CONFIG", "config.invalid"),
        (UsageError("scene.layout_unknown", "x"), "BAD_CONFIG", "scene.layout_unknown"),
        (SceneRefusedError(scene_pb2.SceneReport()), "BAD_SCENE", "scene.refused"),
        (TrainingError("x"), "DIVERGED", "training.failed"),
        (MemoryError(), "OUT_OF_MEMORY", "run.out_of_memory"),
        (RuntimeError("Error code 12 (Cannot allocate memory)"), "OUT_OF_MEMORY", "run.out_of_memory"),
        (type("OutOfMemoryError", (RuntimeError,), {})(), "GPU_OUT_OF_MEMORY", "run.gpu_out_of_memory"),
        (ProcessEndedError(-9), "OUT_OF_MEMORY", "run.out_of_memory"),
        (ProcessEndedError(1), "INTERNAL", "run.crashed"),
        (KeyError("x"), "INTERNAL", "run.crashed"),
    ],
)
def test_every_kind_of_failure_has_its_cause(error: Exception, cause: str, code: str):
    request = describe_failure(error)
    assert worker_pb2.FailCause.Name(request.cause) == f"FAIL_CAUSE_{cause}"
    assert request.code == code
    assert request.message


@pytest.mark.parametrize(
    ("device", "gpus", "variable", "num_ranks"),
    [("cuda", 4, "2", 4), ("cuda", 1, "2", 1), ("cpu", 0, "", 1), ("cpu", 0, "2", 2)],
)
def test_a_training_is_divided_among_the_gpus_of_the_job(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, device: str, gpus: int, variable: str, num_ranks: int
):
    asked = []
    monkeypatch.setattr(pipeline, "run_pipeline", lambda *_, **named: asked.append(named["num_ranks"]))
    monkeypatch.setenv("LAMBENT_RANKS", variable)
    order = Order(
        start=worker_pb2.StartResponse(preset="tiny", gpus=gpus, device=device),
        scene_dir=tmp_path,
        run_dir=tmp_path,
        reporter=RecordingReporter(),
    )
    process.train(order)
    assert asked == [num_ranks]


def test_files_have_the_media_type_of_their_name():
    assert media_type("a/b.exr") == "image/x-exr"
    assert media_type("mesh/asset.glb") == "model/gltf-binary"
    assert media_type("report.html") == "text/html"
    assert media_type("weights.bin") == "application/octet-stream"


def test_a_wrong_secret_is_an_end_and_not_a_retry(stage: Stage, job: str):
    identity = Identity(job_id=job, run=1, address=stage.address, token="no", work_dir=Path())
    connection = Connection(identity)
    with pytest.raises(FencedError):
        connection.call(connection.stub.Heartbeat, heartbeat(connection))
    connection.close()


@pytest.mark.parametrize(("params", "looks"), [({}, 1), ({"layout": "tensoir_synthetic"}, 2)])
def test_a_job_looks_at_a_capture_once_in_one_way_and_tells_every_finding_once(
    stage: Stage, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, params: dict[str, str], looks: int
):
    folder = write_tensoir(tmp_path / "capture")
    shutil.copyfile(folder / "train_000" / "rgba_sunset.png", folder / "train_001" / "rgba_sunset.png")
    paths = [path for path in folder.rglob("*") if path.is_file()]
    files = {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}
    job = stage.start(scene_id=stage.api.scene(files), params=params)
    asked = []

    def look(folder: Path, *how: object) -> CaptureCheck:
        asked.append(how)
        return CaptureCheck(report=inspect_files(folder).report)

    monkeypatch.setattr(check, "check_capture", look)
    monkeypatch.setattr(ingest, "check_capture", look)
    tasks = {"ingest": ingest.run}
    monkeypatch.setattr(pipeline, "_task_function", lambda name: tasks.get(name, lambda context: None))
    reporter = RecordingReporter()
    reporter.broken = None
    connection = connect(stage, job)
    process._do(connection, reporter, stage.call("Start", job), process.perform, process.check)
    connection.close()
    assert len(asked) == looks
    told = [(call["code"], call["subject"]) for call in reporter.named("finding")]
    assert told == [("scene.image_duplicate", "train_001/rgba_sunset.png")]
    assert read_run(connection.identity.work_dir)[0].layout == params.get("layout", "")


@pytest.mark.parametrize(("error", "published"), [(IncompleteError, ["table"]), (UsageError, [])])
def test_what_a_failed_run_made_nevertheless_is_published(
    stage: Stage, tmp_path: Path, error: type[UsageError], published: list[str]
):
    job = stage.start(scene_id=stage.api.scene({"a.json": b"{}"}))
    (tmp_path / "table").write_bytes(b"lines")
    connection = connect(stage, job)
    reporter = ServerReporter(connection, connection.identity.work_dir)

    def fail(order: Order) -> None:
        order.reporter.artifact("table", tmp_path / "table")
        raise error("render.parts_failed", "one is missing")

    def usable(folder: Path) -> CaptureCheck:
        return CaptureCheck(report=scene_pb2.SceneReport(usable=True))

    process._work(connection, reporter, stage.call("Start", job), fail, usable)
    connection.close()
    assert stage.job(job)["state"] == "failed"
    listed = stage.api.get(f"/v1/jobs/{job}/artifacts").json()["items"]
    assert [each["name"] for each in listed] == published
