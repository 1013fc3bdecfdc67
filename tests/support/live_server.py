"""A real server in a process of its own, with a sleep trainer and short time-outs."""

import contextlib
import hashlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx2
import psutil

SLEEP_TRAINER = Path(__file__).with_name("sleep_trainer.py")
FAST = {
    "tick_s": 0.15,
    "heartbeat_s": 0.2,
    "lost_after_s": 1.0,
    "stop_grace_s": 2.0,
    "retry_delay_s": 0.1,
    "progress_interval_s": 0.1,
    "preview_interval_s": 0.2,
    "stream_poll_s": 0.2,
    "stream_ping_s": 0.5,
    "port": 0,
    "local_slots": 4,
    "garbage_after_s": 1.0,
    "disk_floor_bytes": 0,
}
FINAL = {"succeeded", "failed", "cancelled"}


def wait_until(condition: Any, timeout_s: float = 90.0) -> Any:
    """Return the first truthy value of `condition()`; AssertionError when time is up."""
    deadline = time.monotonic() + timeout_s
    while time.monotonic() < deadline:
        value = condition()
        if value:
            return value
        time.sleep(0.02)
    raise AssertionError(f"nothing within {timeout_s} s: {condition}")


class LiveServer:
    """Starts, kills and restarts one server on one data folder, and is a client of it."""

    def __init__(
        self, data: Path, *, key: str = "", environment: dict[str, str] | None = None, **settings: Any
    ) -> None:
        self.data = data
        self.environment = environment or {}
        self.key = key
        self.settings = {**FAST, **settings}
        self.process: subprocess.Popen[bytes] | None = None
        self.client = httpx2.Client(verify=False)
        self.starts = 0
        self.login_url = ""

    def __enter__(self) -> "LiveServer":
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.client.close()
        if self.process is not None and self.process.poll() is None:
            self.process.kill()
            self.process.wait()
        for process in psutil.process_iter():
            # Whatever program the runs are, and wherever they come from.
            with contextlib.suppress(psutil.Error, OSError):
                if str(self.data) in process.environ().get("LAMBENT_RUN", ""):
                    process.kill()

    def start(self) -> None:
        """Start the server and wait until it answers."""
        environment = {**os.environ, **self.environment}
        environment["LAMBENT_RUN_COMMAND"] = json.dumps([sys.executable, str(SLEEP_TRAINER), "run"])
        for name, value in self.settings.items():
            environment[f"LAMBENT_{name.upper()}"] = value if isinstance(value, str) else json.dumps(value)
        self.starts += 1
        self.data.parent.mkdir(parents=True, exist_ok=True)
        log = self.data.parent / f"{self.data.name}-server-{self.starts}.log"
        command = [sys.executable, "-m", "lambent", "serve", "--data", str(self.data)]
        with log.open("wb") as file:
            self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=file, env=environment)
        assert self.process.stdout is not None
        lines = [self.process.stdout.readline().decode() for _ in range(3)]
        self.process.stdout.close()
        if not lines[0]:
            self.process.wait()
            raise AssertionError(log.read_text())
        self.login_url = lines[1].split()[-1]
        self.url = json.loads((self.data / "server.json").read_text())["url"]
        key_file = self.data / "api.key"
        # A second server on a database makes none.
        self.key = key_file.read_text().strip() if key_file.exists() else self.key
        self.client.close()
        # There is not a TLS to verify, and loading the system's certificates takes 25 ms.
        self.client = httpx2.Client(
            base_url=self.url, headers={"Authorization": f"Bearer {self.key}"}, timeout=30.0, verify=False
        )

    def kill(self) -> None:
        """Kill the server like a power failure."""
        assert self.process is not None
        self.process.kill()
        self.process.wait()

    def end(self, number: int = signal.SIGTERM) -> float:
        """Signal the server, wait for its end and return the seconds that took."""
        assert self.process is not None
        began = time.monotonic()
        self.process.send_signal(number)
        self.process.wait(timeout=60)
        return time.monotonic() - began

    def scene(self, *paths: str) -> str:
        """Return a committed scene of small files."""
        scene_id = self.client.post("/v1/scenes", json={"name": "a scene"}).json()["id"]
        contents = {path: path.encode() for path in paths or ("transforms_train.json",)}
        hashes = {path: hashlib.sha256(data).hexdigest() for path, data in contents.items()}
        plan = [{"path": p, "size": len(d), "sha256": hashes[p]} for p, d in contents.items()]
        self.client.post(f"/v1/scenes/{scene_id}/files:plan", json=plan).raise_for_status()
        for path, data in contents.items():
            self.client.put(f"/v1/scenes/{scene_id}/files/{hashes[path]}", content=data).raise_for_status()
        self.client.post(f"/v1/scenes/{scene_id}:commit").raise_for_status()
        return scene_id

    def submit(self, scene_id: str, **params: Any) -> str:
        """Queue a job of the sleep trainer; `params` are described there."""
        texts = {name: str(value) for name, value in params.items()}
        answer = self.client.post("/v1/jobs", json={"scene_id": scene_id, "preset": "tiny", "params": texts})
        assert answer.status_code == 202, answer.text
        return answer.json()["id"]

    def job(self, job_id: str) -> dict[str, Any]:
        """Return the job."""
        answer = self.client.get(f"/v1/jobs/{job_id}")
        assert answer.status_code == 200, answer.text
        return answer.json()

    def wait(self, job_id: str, *states: str, timeout_s: float = 120.0) -> dict[str, Any]:
        """Return the job once it is in one of `states` (any final one by default)."""
        wanted = set(states) or FINAL
        return wait_until(lambda: (job := self.job(job_id))["state"] in wanted and job, timeout_s)

    def wait_step(self, job_id: str, step: int, timeout_s: float = 120.0) -> dict[str, Any]:
        """Return the job once it has done `step` steps."""
        return wait_until(
            lambda: (job := self.job(job_id))["progress"] and job["progress"]["step"] >= step and job,
            timeout_s,
        )

    def events(self, job_id: str) -> list[dict[str, Any]]:
        """Return the whole history."""
        return self.client.get(f"/v1/jobs/{job_id}/events").json()["items"]

    def run_processes(self, part: str = "") -> list[psutil.Process]:
        """Return the supervisors ("run") and pipelines ("work") that this server's jobs have running."""
        found = []
        for process in psutil.process_iter():
            try:
                command = process.cmdline()
                ours = command[1:2] == [str(SLEEP_TRAINER)] and command[2] in (part or command[2])
                if ours and str(self.data) in process.environ().get("LAMBENT_RUN", ""):
                    found.append(process)
            except (psutil.Error, OSError, IndexError):
                continue
        return found

    def supervisor(self, job_id: str) -> psutil.Process:
        """Return the supervisor of a job's run."""
        return wait_until(
            lambda: next((p for p in self.run_processes("run") if job_id in p.environ()["LAMBENT_RUN"]), None)
        )


def stream(url: str, key: str, jobs: list[str], last: str | None = None) -> Iterator[tuple[str, str, Any]]:
    """Yield (kind, id, data) of an event stream until it ends; a ping is a kind too."""
    headers = {"Authorization": f"Bearer {key}"}
    if last is not None:
        headers["Last-Event-ID"] = last
    with httpx2.stream(
        "GET", f"{url}/v1/events", params={"job": jobs}, headers=headers, timeout=30.0, verify=False
    ) as response:
        assert response.status_code == 200
        kind, identifier = "", ""
        for line in response.iter_lines():
            if line.startswith("event: "):
                kind = line.removeprefix("event: ")
            elif line.startswith("id: "):
                identifier = line.removeprefix("id: ")
            elif line.startswith("data: "):
                yield kind, identifier, json.loads(line.removeprefix("data: "))
            elif line.startswith(":"):
                yield "ping", "", None
