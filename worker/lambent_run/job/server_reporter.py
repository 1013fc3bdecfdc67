"""The `Reporter` of a run that a server started: it sends everything to the server."""

import json
import mimetypes
import sys
import tempfile
import threading
import time
from collections import deque
from pathlib import Path

from lambent_core.files import read_record
from lambent_proto.v1 import job_pb2, worker_pb2

from lambent_run.job.connection import Connection, FencedError, RefusedError, UnreachableError

MAX_WAITING_EVENTS = 2000
MAX_PREVIEW_BYTES = 256 * 1024
# Kinds the standard table does not know.
_MEDIA_TYPES = {
    ".exr": "image/x-exr",
    ".glb": "model/gltf-binary",
    ".hdr": "image/vnd.radiance",
    ".npy": "application/x-npy",
    ".onnx": "application/onnx",
    ".webp": "image/webp",
}


def media_type(name: str) -> str:
    """Return the media type of a file by its name."""
    known = _MEDIA_TYPES.get(Path(name).suffix.lower())
    return known or mimetypes.guess_type(name)[0] or "application/octet-stream"


class ServerReporter:
    """Sends progress now and then from a thread of its own, so that no task waits for the server.

    Checkpoints and artifacts are sent at once, and the caller waits until they are safe.
    """

    def __init__(
        self,
        connection: Connection,
        run_dir: Path,
        *,
        code_version: str = "",
        progress_interval_s: float = 1.0,
        preview_interval_s: float = 10.0,
    ) -> None:
        self._connection = connection
        self._run_dir = run_dir
        self._code_version = code_version
        self._progress_interval_s = progress_interval_s
        self._preview_interval_s = preview_interval_s
        self._lock = threading.Lock()
        self._wake = threading.Event()
        self._progress: job_pb2.Progress | None = None
        self._events: deque[job_pb2.Event] = deque(maxlen=MAX_WAITING_EVENTS)
        self._preview: tuple[str, bytes] | None = None
        self._preview_sent_at = 0.0
        self._sequence = 0
        # Set by handlers of signals, which may interrupt one another: an Event has a lock to wait for.
        self._stop = False
        self._closing = False
        self.broken: Exception | None = None
        self.artifacts: list[worker_pb2.PublishedFile] = []
        self._thread = threading.Thread(target=self._pump, name="reporter", daemon=True)
        self._thread.start()

    def request_stop(self) -> None:
        """Ask the pipeline to end at its next step."""
        self._stop = True

    def should_stop(self) -> bool:
        """Return whether the run was asked to end, or has been given up by the server."""
        return self._stop

    def progress(self, progress: job_pb2.Progress) -> None:
        """Note how far the run is; the newest note is sent at the next occasion."""
        with self._lock:
            self._progress = progress

    def preview(self, name: str, png: bytes) -> None:
        """Show a small picture; only the newest of an interval is sent."""
        if len(png) > MAX_PREVIEW_BYTES:
            self.log("preview.too_large", name=name, size_bytes=len(png))
            return
        with self._lock:
            self._preview = (name, png)

    def checkpoint(self, stage: str, step: int, folder: Path) -> None:
        """Send the files in `folder` and make them what a next run resumes from."""
        files = []
        for path in sorted(path for path in folder.rglob("*") if path.is_file()):
            sent = self._connection.put_file(path)
            relative = path.relative_to(self._run_dir).as_posix()
            files.append(
                job_pb2.CheckpointFile(path=relative, sha256=sent.sha256, size_bytes=sent.size_bytes)
            )
        identity = self._connection.identity
        manifest = job_pb2.CheckpointManifest(
            job_id=identity.job_id,
            run=identity.run,
            stage=stage,
            step=step,
            config_sha256=read_record(folder / "state.json").get("config_sha256", ""),
            code_version=self._code_version,
            files=files,
        )
        request = worker_pb2.CommitCheckpointRequest(fence=identity.fence, manifest=manifest)
        self._connection.call(self._connection.stub.CommitCheckpoint, request)

    def artifact(self, name: str, path: Path) -> None:
        """Send a file of the result; it becomes visible together with everything else."""
        sent = self._connection.put_file(path, media_type(name))
        sent.path = name
        self.artifacts = [each for each in self.artifacts if each.path != name] + [sent]

    def finding(self, code: str, message: str, *, subject: str = "", error: bool = False) -> None:
        """Tell the owner of the scene something about it."""
        self._add(job_pb2.Event(type="finding", message=f"{code}: {message}", name=subject))

    def log(self, event: str, **fields: object) -> None:
        """Write a line to the run's log and to the job's history."""
        line = json.dumps({"event": event, **fields}, default=str)
        print(line, file=sys.stderr, flush=True)
        self._add(job_pb2.Event(type="log", message=line))

    def _add(self, event: job_pb2.Event) -> None:
        with self._lock:
            self._events.append(event)

    def close(self) -> None:
        """Send what is left and end the thread; raises what kept it from being sent."""
        self._closing = True
        self._wake.set()
        self._thread.join()
        if self.broken is not None:
            raise self.broken

    def _pump(self) -> None:
        try:
            while True:
                self._wake.wait(self._progress_interval_s)
                closing = self._closing
                self._send(last=closing)
                if closing:
                    return
        except (FencedError, RefusedError, UnreachableError) as error:
            # The pipeline's thread finds it when it asks whether to stop.
            self.broken = error
            self._stop = True

    def _send(self, *, last: bool) -> None:
        self._send_preview(last=last)
        while True:
            with self._lock:
                progress, self._progress = self._progress, None
                events = [self._events.popleft() for _ in range(min(len(self._events), 200))]
            if progress is None and not events:
                return
            self._sequence += 1
            request = worker_pb2.ReportRequest(
                fence=self._connection.identity.fence,
                sequence=self._sequence,
                progress=progress,
                events=events,
            )
            reply = self._connection.call(self._connection.stub.Report, request)
            self._connection.stub.learn(reply.servers)
            if reply.stop:
                self._stop = True

    def _send_preview(self, *, last: bool) -> None:
        with self._lock:
            due = last or time.monotonic() - self._preview_sent_at >= self._preview_interval_s
            if self._preview is None or not due:
                return
            (name, png), self._preview = self._preview, None
        self._preview_sent_at = time.monotonic()
        with tempfile.NamedTemporaryFile(suffix=".png") as file:
            file.write(png)
            file.flush()
            sent = self._connection.put_file(Path(file.name), "image/png")
        self._add(job_pb2.Event(type="preview", name=name, sha256=sent.sha256))
