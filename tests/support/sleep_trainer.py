"""A run process whose pipeline only sleeps, for tests of the service's faults without a model.

`python sleep_trainer.py run` stands where `python -m lambent_run run` would. The order's `params` steer
it: `num_steps`, `until` (a file: once it is there, the step in work is the last), `step_s`, `stage`,
`checkpoint_every`, `hang_at`, `fail_at` (with `fail_how`, and `fail_once`: a file that the first failure
makes), `touch`: a file that gets a line each time the pipeline comes to its end, and `bundle`: an archive of
a bundle to publish in place of one that only counts.
"""

import hashlib
import json
import os
import sys
import time
import zipfile
from pathlib import Path

from google.protobuf.json_format import MessageToJson
from lambent_capture.checks.check_result import CaptureCheck
from lambent_core.errors import Stopped, WorkerError
from lambent_proto.v1 import bundle_pb2, scene_pb2
from lambent_proto.v1.job_pb2 import Progress
from lambent_run.job.order import Order
from lambent_run.job.process import work
from lambent_run.job.supervisor import supervise

PNG = bytes.fromhex(
    "89504e470d0a1a0a0000000d494844520000000100000001080200000090"
    "7753de0000000c49444154789c63f8cfc0000003010100c9fe92ef0000000049454e44ae426082"
)


def fail(how: str) -> None:
    """Fail in the requested way."""
    if how == "exit":
        os._exit(7)
    if how == "memory":
        bytearray(3 * 2**30)
    if how == "worker_error":
        raise WorkerError("test.failed", "the test asked for it")
    raise RuntimeError("the test asked for it")


def pipeline(order: Order) -> Path:
    """Count steps, keep the count in checkpoints, and write a bundle that says how far it came."""
    params = order.start.params
    num_steps = int(params.get("num_steps", "20"))
    stage = params.get("stage", "joint")
    until = Path(params["until"]) if "until" in params else None
    step_s = float(params.get("step_s", "0.02"))
    every = int(params.get("checkpoint_every", "5"))
    folder = order.run_dir / "joint"
    found = sorted(folder.glob("step_*/state.json"))
    first = json.loads(found[-1].read_text())["step"] if found else 0
    order.reporter.log("sleep.started", first_step=first, run_pid=os.getpid())
    for step in range(first + 1, num_steps + 1):
        time.sleep(step_s)
        if step == int(params.get("fail_at", "0")) and first < step:
            once = Path(params["fail_once"]) if "fail_once" in params else None
            if once is None or not once.exists():
                if once is not None:
                    once.touch()
                fail(params.get("fail_how", ""))
        while step == int(params.get("hang_at", "0")):
            time.sleep(0.1)
        order.reporter.progress(
            Progress(
                stage=stage,
                step=step,
                num_steps=num_steps,
                fraction=step / num_steps,
                eta_s=(num_steps - step) * step_s,
                steps_per_s=1 / step_s if step_s else 0.0,
                loss=1.0 / step,
                psnr=20.0 + step / num_steps,
            )
        )
        order.reporter.preview("view", PNG)
        stopping = order.reporter.should_stop()
        if step % every == 0 or stopping:
            target = folder / f"step_{step:06d}"
            target.mkdir(parents=True, exist_ok=True)
            (target / "state.json").write_text(json.dumps({"step": step, "run_dir": str(order.run_dir)}))
            order.reporter.checkpoint("joint", step, target)
        if stopping:
            raise Stopped
        if until is not None and until.exists():
            break
    return write_result(order, num_steps)


def write_result(order: Order, num_steps: int) -> Path:
    """Write a bundle and an artifact."""
    bundle = order.run_dir / "bundle"
    if "bundle" in order.start.params:
        with zipfile.ZipFile(order.start.params["bundle"]) as archive:
            archive.extractall(bundle)
        _add_rendering(bundle)
        return bundle
    (bundle / "models").mkdir(parents=True)
    weights = bytes(range(256)) * 40
    (bundle / "models" / "weights.bin").write_bytes(weights)
    manifest = bundle_pb2.BundleManifest(schema_version="1", scene_id=order.start.scene_id, name="sleep")
    manifest.generator.train_step = num_steps
    manifest.files.add(
        path="models/weights.bin",
        size_bytes=len(weights),
        sha256=hashlib.sha256(weights).hexdigest(),
        role="weights",
    )
    text = MessageToJson(
        manifest, preserving_proto_field_name=True, always_print_fields_with_no_presence=True
    )
    (bundle / "manifest.json").write_text(text)
    report = order.run_dir / "report.json"
    report.write_text('{"metrics": []}')
    order.reporter.artifact("report.json", report)
    if "touch" in order.start.params:
        with Path(order.start.params["touch"]).open("a") as file:
            file.write(f"{order.run_dir.name}\n")
    return bundle


def _add_rendering(bundle: Path) -> None:
    """Add a picture to a bundle that may have none."""
    (bundle / "preview").mkdir(exist_ok=True)
    (bundle / "preview" / "000.png").write_bytes(PNG)
    manifest = json.loads((bundle / "manifest.json").read_text())
    digest = hashlib.sha256(PNG).hexdigest()
    entry = {"path": "preview/000.png", "size_bytes": len(PNG), "sha256": digest}
    manifest["files"].append(entry | {"role": "preview"})
    (bundle / "manifest.json").write_text(json.dumps(manifest))


def check(scene_dir: Path) -> CaptureCheck:
    """Accept every scene but one with a file called reject.txt."""
    if (scene_dir / "reject.txt").exists():
        finding = scene_pb2.Finding(
            code="scene.test",
            severity=scene_pb2.SEVERITY_ERROR,
            message="fix reject.txt",
            subject="reject.txt",
        )
        return CaptureCheck(report=scene_pb2.SceneReport(usable=False, findings=[finding]))
    report = scene_pb2.SceneReport(usable=True, layout="nerf_blender", num_train_frames=3, num_test_frames=1)
    return CaptureCheck(report=report)


if __name__ == "__main__":
    if sys.argv[1:] == ["run"]:
        sys.exit(supervise([sys.executable, __file__, "work"]))
    sys.exit(work(pipeline, check))
