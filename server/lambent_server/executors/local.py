"""Run processes on this machine, each in a session of its own so that a signal reaches all its children."""

import contextlib
import json
import os
import signal
import subprocess
from collections.abc import Sequence
from pathlib import Path

import psutil

from lambent_server.executors import Gone, Handle, Launch


def count_gpus() -> int:
    """Return the number of NVIDIA devices, without loading a driver."""
    return len(list(Path("/dev").glob("nvidia[0-9]*")))


def process_identity(pid: int) -> str | None:
    """Return what tells a process from a later one with the same pid, or None where there is none.

    Linux: boot id and start time in clock ticks, which no change of the clock moves. A zombie is none.
    """
    try:
        process = psutil.Process(pid)
        if process.status() == psutil.STATUS_ZOMBIE:
            return None
        stat = Path(f"/proc/{pid}/stat")
        if not stat.exists():
            return f"created:{process.create_time():.2f}"
        ticks = stat.read_text().rpartition(")")[2].split()[19]
        boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
    except (psutil.NoSuchProcess, psutil.ZombieProcess, FileNotFoundError, ProcessLookupError):
        return None
    return f"{boot}:{ticks}"


class LocalExecutor:
    """Subprocesses of the server that outlive it."""

    def __init__(self, command: Sequence[str]) -> None:
        self._command = tuple(command)
        self._children: dict[int, subprocess.Popen[bytes]] = {}

    def start(self, launch: Launch) -> Handle:
        """Start a run process; its output goes to `run-<n>.log` in the job's folder."""
        launch.work_dir.mkdir(parents=True, exist_ok=True)
        environment = dict(os.environ)
        environment["LAMBENT_RUN"] = json.dumps(
            {
                "job_id": launch.job_id,
                "run": launch.run,
                "address": launch.address,
                "token": launch.token,
                "work_dir": str(launch.work_dir),
            }
        )
        # The run process needs the server's address and nothing else of its configuration.
        for name in ("LAMBENT_DATABASE", "LAMBENT_STORE", "LAMBENT_API_KEY"):
            environment.pop(name, None)
        environment["CUDA_VISIBLE_DEVICES"] = ",".join(map(str, launch.gpus))
        with (launch.work_dir.parent / f"run-{launch.run}.log").open("ab") as log:
            child = subprocess.Popen(
                self._command,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                env=environment,
                start_new_session=True,
            )
        self._children[child.pid] = child
        return {"pid": child.pid, "identity": process_identity(child.pid), "gpus": list(launch.gpus)}

    def poll(self, handle: Handle) -> Gone | None:
        """Return None while the process is there, otherwise how it ended where this server started it."""
        pid = int(handle["pid"])
        child = self._children.get(pid)
        if child is not None:
            code = child.poll()
            if code is None:
                return None
            del self._children[pid]
            self._end_group(pid)
            return Gone(code)
        if self.adopt(handle):
            return None
        self._end_group(pid)
        return Gone(None)

    def stop(self, handle: Handle, *, force: bool) -> None:
        """Signal the process group: SIGTERM, or SIGKILL with `force`."""
        if self.poll(handle) is None:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(int(handle["pid"]), signal.SIGKILL if force else signal.SIGTERM)

    def adopt(self, handle: Handle) -> bool:
        """Return whether the very process of the handle is there."""
        identity = process_identity(int(handle["pid"]))
        return identity is not None and identity == handle["identity"]

    @staticmethod
    def _end_group(leader: int) -> None:
        """End what is left of the session of a leader that is gone."""
        for process in psutil.process_iter():
            with contextlib.suppress(ProcessLookupError, PermissionError, psutil.Error):
                if os.getsid(process.pid) == leader and process.pid != leader:
                    process.kill()
