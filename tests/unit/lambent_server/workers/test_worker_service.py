"""The rights of run processes: only the current run, only once, only whole files."""

import hashlib
import threading
from collections.abc import Iterator
from pathlib import Path

import grpc
import pytest
from google.protobuf.json_format import MessageToJson
from lambent_proto import BUNDLE_VERSION
from lambent_proto.v1 import bundle_pb2, worker_pb2
from support.runs import Stage, metadata, refused, staged, token

STALE = grpc.StatusCode.FAILED_PRECONDITION


@pytest.fixture
def stage(tmp_path: Path) -> Iterator[Stage]:
    with staged(tmp_path, progress_interval_s=0.001) as stage:
        yield stage


def publish(stage: Stage, job: str, run: int = 1, version: str = BUNDLE_VERSION, **files: bytes) -> str:
    """Publish a bundle of these files as a run."""
    contents = {name.replace("_", "."): data for name, data in files.items()} or {"weights.bin": b"weights"}
    manifest = bundle_pb2.BundleManifest(schema_version=version)
    for name, data in contents.items():
        manifest.files.add(path=name, sha256=hashlib.sha256(data).hexdigest())
    contents["manifest.json"] = MessageToJson(manifest, preserving_proto_field_name=True).encode()
    listed = [
        {"path": name, "sha256": stage.put(job, data, run), "size_bytes": len(data)}
        for name, data in contents.items()
    ]
    return str(stage.call("Publish", job, run, bundle_files=listed).bundle_id)


@pytest.mark.parametrize("version", ["", "1.3", "2"])
def test_a_bundle_of_another_version_is_refused_with_what_to_do(stage: Stage, version: str):
    job = stage.start()
    with refused(grpc.StatusCode.INVALID_ARGUMENT) as caught:
        publish(stage, job, version=version)
    told = caught.value.details()
    assert (
        f"format version '{version}', this server takes version '1' alone; install the same release" in told
    )


def test_only_the_current_run_is_heard(stage: Stage):
    job = stage.start()
    digest = stage.put(job, b"old")
    stage.end()
    assert stage.job(job)["run"] == 2
    for method in ("Register", "Start", "Heartbeat", "Report", "ReportScene", "CommitCheckpoint"):
        with refused(STALE):
            stage.call(method, job, 1)
    for method in ("Publish", "Finish", "Fail"):
        with refused(STALE):
            stage.call(method, job, 1)
    with refused(STALE):
        stage.put(job, b"from the past")
    with refused(STALE):
        list(
            stage.stub.GetBlob(
                worker_pb2.GetBlobRequest(fence={"job_id": job, "run": 1}, sha256=digest),
                metadata=(("authorization", f"Bearer {token(job, 1)}"),),
            )
        )
    stage.call("Heartbeat", job, 2)


def test_a_run_that_failed_is_not_heard_while_its_job_waits_for_the_next_try(tmp_path: Path):
    with staged(tmp_path, retry_delay_s=1000.0) as stage:
        job = stage.start()
        stage.call("Fail", job, cause="FAIL_CAUSE_INTERNAL", code="x", message="y")
        assert stage.job(job)["state"] == "retry_wait"
        for method in ("Heartbeat", "Report", "Publish"):
            with refused(STALE):
                stage.call(method, job)


def test_a_token_is_good_for_one_run_of_one_job(stage: Stage):
    job = stage.start()
    for wrong in (token(job, 2), token("job_x", 1), "x"):
        with refused(grpc.StatusCode.UNAUTHENTICATED):
            stage.call("Heartbeat", job, 1, token=wrong)
    with refused(grpc.StatusCode.NOT_FOUND):
        stage.call("Heartbeat", "job_x", 1)


def test_a_report_sent_twice_is_stored_once(stage: Stage):
    job = stage.start()
    for _ in range(2):
        stage.call("Report", job, sequence=1, events=[{"type": "log", "message": "once\0"}])
    stage.call("Report", job, sequence=2, events=[{"type": "log", "message": "twice"}])
    events = stage.api.get(f"/v1/jobs/{job}/events").json()["items"]
    assert [each["message"] for each in events if each["type"] == "log"] == ["once", "twice"]
    assert [each["seq"] for each in events] == list(range(1, len(events) + 1))


def test_progress_is_shown_and_kept_now_and_then(tmp_path: Path):
    with staged(tmp_path, progress_interval_s=1000.0) as stage:
        job = stage.start()
        for step in (1, 2, 3):
            progress = {"stage": "cache", "step": step, "num_steps": 9}
            stage.call("Report", job, sequence=step, progress=progress)
        assert stage.job(job)["progress"]["step"] == 3
        events = stage.api.get(f"/v1/jobs/{job}/events").json()["items"]
        assert [each["progress"]["step"] for each in events if each["type"] == "progress"] == [1]


def test_a_run_cannot_write_history_of_other_kinds(stage: Stage):
    job = stage.start()
    with refused(grpc.StatusCode.INVALID_ARGUMENT):
        stage.call("Report", job, sequence=1, events=[{"type": "state", "message": "x"}])


def test_a_blob_with_another_hash_is_not_kept(stage: Stage):
    job = stage.start()
    with refused(grpc.StatusCode.DATA_LOSS):
        stage.put(job, b"broken", sha256="0" * 64)
    assert stage.api.get(f"/v1/blobs/{'0' * 64}").status_code == 404


def test_more_bytes_than_were_announced_are_refused_at_once(stage: Stage):
    job = stage.start()
    header = worker_pb2.BlobHeader(fence={"job_id": job, "run": 1}, sha256="0" * 64, size_bytes=3)
    given = [{"header": header}, {"data": b"ab"}, {"data": b"cd"}]
    messages = [worker_pb2.PutBlobRequest(**each) for each in given]
    with refused(grpc.StatusCode.INVALID_ARGUMENT):
        stage.stub.PutBlob(iter(messages), metadata=metadata(job, 1, None), timeout=5)


def test_strangers_who_send_nothing_keep_no_thread_from_runs(stage: Stage):
    job = stage.start()
    silent = threading.Event()

    def nothing() -> Iterator[worker_pb2.PutBlobRequest]:
        silent.wait(20)
        yield from ()

    calls = [stage.stub.PutBlob.future(nothing(), metadata=metadata(job, 1, "x")) for _ in range(32)]
    try:
        stage.call("Heartbeat", job)
    finally:
        silent.set()
    assert {call.code() for call in calls} == {grpc.StatusCode.UNAUTHENTICATED}


def test_a_run_is_told_of_bytes_that_were_lost(stage: Stage):
    job = stage.start()
    digest = stage.put(job, b"state")
    next((stage.api.services.settings.data / "store").rglob(digest)).write_bytes(b"st")
    request = worker_pb2.GetBlobRequest(fence={"job_id": job, "run": 1}, sha256=digest)
    with refused(grpc.StatusCode.INVALID_ARGUMENT):
        list(stage.stub.GetBlob(request, metadata=metadata(job, 1, None)))


def test_the_last_two_checkpoints_and_one_per_stage_are_kept(stage: Stage):
    job = stage.start()
    for step, name in enumerate(("cache", "cache", "cache", "joint", "joint", "joint")):
        digest = stage.put(job, f"state {step}".encode())
        files = [{"path": f"{name}/s{step}", "sha256": digest, "size_bytes": 7}]
        stage.call("CommitCheckpoint", job, manifest={"stage": name, "step": step, "files": files})
    kept = stage.call("Start", job).checkpoints
    assert [(each.stage, each.step) for each in kept] == [("cache", 2), ("joint", 4), ("joint", 5)]
    assert kept[0].files[0].path == "cache/s2"


def test_a_checkpoint_needs_its_files_and_safe_paths(stage: Stage):
    job = stage.start()
    digest = stage.put(job, b"state")
    for path, sha256 in (("cache/a", "0" * 64), ("../a", digest), ("/a", digest)):
        with refused(grpc.StatusCode.INVALID_ARGUMENT):
            manifest = {"stage": "cache", "files": [{"path": path, "sha256": sha256}]}
            stage.call("CommitCheckpoint", job, manifest=manifest)
    assert stage.call("Start", job).checkpoints == []


def test_publishing_makes_bundle_and_success_visible_at_once_and_once(stage: Stage):
    job = stage.start()
    first = publish(stage, job)
    found = stage.job(job)
    assert (found["state"], found["bundle_id"]) == ("succeeded", first)
    assert stage.api.get(f"/v1/bundles/{first}/files/weights.bin").content == b"weights"
    # The answer was lost and the run asks again.
    assert stage.call("Publish", job).bundle_id == first
    stage.call("Fail", job, cause="FAIL_CAUSE_INTERNAL", code="x", message="too late")
    assert stage.job(job)["state"] == "succeeded"


def test_a_bundle_whose_manifest_differs_from_its_files_is_refused_whole(stage: Stage):
    job = stage.start()
    good = stage.put(job, b"weights")
    manifest = bundle_pb2.BundleManifest()
    manifest.files.add(path="weights.bin", sha256="0" * 64)
    for text in (MessageToJson(manifest).encode(), b"no json", b'{"unknown": 1}', b"\xff\xfe"):
        files = [
            {"path": "manifest.json", "sha256": stage.put(job, text), "size_bytes": len(text)},
            {"path": "weights.bin", "sha256": good, "size_bytes": 7},
        ]
        artifacts = [{"path": "report.json", "sha256": good, "size_bytes": 7}]
        with refused(grpc.StatusCode.INVALID_ARGUMENT):
            stage.call("Publish", job, bundle_files=files, artifacts=artifacts)
    assert stage.job(job)["state"] == "running"
    assert stage.api.get(f"/v1/jobs/{job}/artifacts").json()["items"] == []


@pytest.mark.parametrize("size_bytes", [6, 8])
def test_a_published_file_must_have_the_size_it_states(stage: Stage, size_bytes: int):
    job = stage.start()
    artifact = {"path": "report.json", "sha256": stage.put(job, b"weights"), "size_bytes": size_bytes}
    with refused(grpc.StatusCode.INVALID_ARGUMENT):
        stage.call("Publish", job, artifacts=[artifact])


def test_a_cancelled_run_cannot_publish(stage: Stage):
    job = stage.start()
    stage.api.post(f"/v1/jobs/{job}:cancel")
    assert stage.call("Heartbeat", job).stop
    with refused(STALE):
        publish(stage, job)
    assert stage.job(job)["bundle_id"] is None


def test_a_scene_report_makes_the_scene_ready_or_rejected(stage: Stage):
    scene = stage.api.scene({"a.json": b"1", "b.pkl.json": b"2"})
    job = stage.start(scene_id=scene, kind="check")
    assert stage.call("Start", job).check_scene
    finding = {"code": "scene.blurred", "severity": "SEVERITY_WARNING", "message": "soft", "subject": "r_0"}
    stage.call("ReportScene", job, report={"usable": True, "layout": "nerf_blender", "findings": [finding]})
    assert not stage.call("Start", job).check_scene
    assert stage.api.get(f"/v1/scenes/{scene}").json()["state"] == "ready"
    report = stage.api.get(f"/v1/scenes/{scene}/report").json()
    assert report["checked"]
    assert report["findings"] == [{**finding, "severity": "warning"}]
    finding["severity"] = "SEVERITY_ERROR"
    stage.call("ReportScene", job, report={"usable": False, "findings": [finding]})
    assert stage.api.get(f"/v1/scenes/{scene}").json()["state"] == "rejected"


def test_a_run_reads_blobs_of_its_own_tenant_only(stage: Stage):
    from support.api import STRANGER

    job = stage.start()
    data = b"of a stranger"
    path = stage.api.services.settings.scratch / "x"
    path.write_bytes(data)
    digest = hashlib.sha256(data).hexdigest()
    stage.api.services.store.put_file(stage.api.services.database.write, STRANGER, path, digest, "text/plain")
    path.unlink()
    request = worker_pb2.GetBlobRequest(fence={"job_id": job, "run": 1}, sha256=digest)
    with refused(grpc.StatusCode.NOT_FOUND):
        list(stage.stub.GetBlob(request, metadata=(("authorization", f"Bearer {token(job, 1)}"),)))
