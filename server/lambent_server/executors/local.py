"""Run processes on this machine, each in a session of its own so that a signal reaches all its children."""

import contextlib
import fnmatch
import json
import os
import re
import signal
import subprocess
import threading
import uuid
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import psutil
import structlog

from lambent_server.core.settings import Settings
from lambent_server.executors import (
    ExecutorAwayError,
    Gone,
    Handle,
    Launch,
    run_name,
    told_in_environment,
)
from lambent_server.executors.groups import Groups
from lambent_server.executors.rooms import LocalRoom

log = structlog.get_logger()

_SHARE_OF_MEMORY = 0.9

# The variables of the server's environment that run processes get: those that programs need, and no secrets.
PASSED_ON = (
    *("PATH", "HOME", "USER", "LOGNAME", "SHELL", "LANG", "LANGUAGE", "LC_*", "TZ", "TMPDIR", "TEMP", "TMP"),
    *("PYTHON*", "VIRTUAL_ENV", "LD_LIBRARY_PATH", "LD_PRELOAD", "DYLD_*", "MALLOC_*", "XDG_*"),
    *("OMP_*", "GOMP_*", "KMP_*", "MKL_*", "OPENBLAS_*", "NUMBA_*", "TORCH*", "PYTORCH_*", "TRITON_*"),
    *("CUDA_*", "CUBLAS_*", "CUDNN_*", "NCCL_*", "LAMBENT_KERNELS"),
    *("NVIDIA_VISIBLE_DEVICES", "NVIDIA_DRIVER_CAPABILITIES", "NVIDIA_TF32_OVERRIDE"),
)
# A name that a pattern happens to match.
SECRET = re.compile(r"(?i)secret|token|passw|credential|(^|_)(api_?)?key(_|$)")


def count_gpus() -> int:
    """Return the number of NVIDIA devices, without loading a driver."""
    return len(list(Path("/dev").glob("nvidia[0-9]*")))


def machine_memory_bytes() -> int:
    """Return the memory of this machine, or the limit of this container if it is lower."""
    total = int(psutil.virtual_memory().total)
    with contextlib.suppress(OSError, ValueError):  # "max" if there is no limit.
        total = min(total, int(Path("/sys/fs/cgroup/memory.max").read_text(encoding="ascii")))
    return total


def host_identity() -> str:
    """Return an identity of the pid namespace that differs from all others, and after a reboot.

    Linux: boot id and pid namespace, so that two containers of one machine differ.
    """
    with contextlib.suppress(OSError):
        boot = Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
        return f"{boot}:{Path('/proc/self/ns/pid').stat().st_ino}"
    return f"{uuid.getnode():012x}"


def process_identity(pid: int) -> str | None:
    """Return an identity of a process that no other process has, or None if it is gone or a zombie.

    It ends with the start time: on Linux in clock ticks since boot, which changes of the clock do not affect.
    """
    try:
        process = psutil.Process(pid)
        if process.status() == psutil.STATUS_ZOMBIE:
            return None
        stat = Path(f"/proc/{pid}/stat")
        if not stat.exists():
            return f"{host_identity()}:{process.create_time():.2f}"
        ticks = stat.read_text().rpartition(")")[2].split()[19]
    except (psutil.NoSuchProcess, psutil.ZombieProcess, FileNotFoundError, ProcessLookupError):
        return None
    return f"{host_identity()}:{ticks}"


def run_environment(environment: Mapping[str, str], more: Sequence[str]) -> dict[str, str]:
    """Return the variables that a run process gets: `PASSED_ON` and those that match one of `more`.

    Names that sound like a secret are passed on only if they are in `more` letter by letter.
    """
    patterns = (*PASSED_ON, *more)
    return {
        name: value
        for name, value in environment.items()
        if any(fnmatch.fnmatchcase(name, pattern) for pattern in patterns)
        and (name in more or SECRET.search(name) is None)
    }


class LocalExecutor:
    """Subprocesses of the server that outlive it.

    Only processes that are proven to be ours are killed: a process by its identity; the rest of its session
    if its leader is our child and not yet reaped, or if the environment of a process names the run.
    """

    runs_elsewhere = False

    def __init__(self, settings: Settings, groups: Groups | None = None) -> None:
        self._settings = settings
        self._groups = groups
        self._memory_bytes = settings.run_memory_bytes
        if self._memory_bytes is None:
            self._memory_bytes = int(_SHARE_OF_MEMORY * machine_memory_bytes() / max(settings.local_slots, 1))
        self._counted_gpus = count_gpus()
        self._children: dict[str, subprocess.Popen[bytes]] = {}
        # The loop of the controller asks, and on Ctrl-C whoever waits for the ends of runs.
        self._reaping = threading.Lock()

    def room(self, own: Sequence[Handle], _others: Sequence[Handle]) -> LocalRoom:
        """Return the free places and GPUs of this machine."""
        in_use = {gpu for handle in own for gpu in handle.get("gpus", ())}
        free = [gpu for gpu in range(self.max_gpus()) if gpu not in in_use]
        return LocalRoom(self._settings.local_slots - len(own), free)

    def max_gpus(self) -> int:
        """Return the number of GPUs of this machine, or that of the settings."""
        given = self._settings.local_gpus
        return self._counted_gpus if given is None else given

    def num_places(self) -> int:
        """Return how many runs this machine may have at the same time; at least 1."""
        return max(self._settings.local_slots, 1)

    def start(self, launch: Launch) -> Handle:
        """Start a run process; its output goes to `run-<n>.log` in the job's folder."""
        launch.work_dir.mkdir(parents=True, exist_ok=True)
        environment = run_environment(os.environ, self._settings.run_environment)
        told = told_in_environment(launch, self._settings)
        here = {"work_dir": str(launch.work_dir), "memory_bytes": self._memory_bytes}
        environment["LAMBENT_RUN"] = json.dumps({**told, **here})
        environment["LAMBENT_SANDBOX"] = self._settings.sandbox
        environment["LAMBENT_RUN_SLOTS"] = str(max(self._settings.local_slots, 1))
        environment["CUDA_VISIBLE_DEVICES"] = ",".join(map(str, launch.gpus))
        with (launch.work_dir.parent / f"run-{launch.run}.log").open("ab") as log:
            child = subprocess.Popen(
                self._settings.run_command,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                env=environment,
                start_new_session=True,
            )
        run = run_name(launch.job_id, launch.run)
        self._children[run] = child
        self._confine(run, child.pid)
        return {
            "pid": child.pid,
            "identity": process_identity(child.pid),
            "run": run,
            "gpus": list(launch.gpus),
        }

    def _confine(self, run: str, pid: int) -> None:
        """Put a process that has hardly begun into a group with the limits of the whole run."""
        if self._groups is None:
            return
        try:
            memory_bytes, processes = self._memory_bytes or 0, self._settings.run_processes
            self._groups.make(run, memory_bytes=memory_bytes, processes=processes)
            self._groups.join(run, pid)
        except OSError as error:
            log.warning("run_without_group", run=run, error=str(error), instead="limits of each process")

    def sees(self, handle: Handle) -> bool:
        """Return whether the process was started in this pid namespace since the machine was booted."""
        host = str(handle.get("identity", "")).rpartition(":")[0]
        return handle.get("executor", "local") == "local" and host == host_identity()

    def poll(self, handle: Handle, *, has_reported: bool = False) -> Gone | None:
        """Return None while the process exists, otherwise how it ended, if this server started it."""
        if handle.get("executor", "local") != "local":
            raise ExecutorAwayError(f"the run was started by the executor {handle['executor']}")
        run = handle.get("run", "")
        with self._reaping:
            child = self._children.get(run)
            if child is not None and process_identity(child.pid) is not None:
                return None
            if child is not None:
                # Not reaped yet, so no other process can have its pid.
                _end_session(child.pid, lambda _: True)
                self._end_group(run)
                return Gone(self._children.pop(run).wait())
        if _exists(handle):
            return None
        if run and str(handle["identity"]).rpartition(":")[0] == host_identity():
            _end_session(int(handle["pid"]), lambda process: _run_of(process) == run)
            self._end_group(run)
        return Gone(None)

    def _end_group(self, run: str) -> None:
        if self._groups is not None:
            self._groups.end(run)

    def stop(self, handle: Handle, *, force: bool) -> None:
        """Signal the process group: SIGTERM, or SIGKILL with `force`."""
        if handle.get("executor", "local") == "local" and _exists(handle):
            with contextlib.suppress(ProcessLookupError):
                os.killpg(int(handle["pid"]), signal.SIGKILL if force else signal.SIGTERM)

    def adopt(self, _handle: Handle) -> bool:
        """Return False: a process is its server's, which has its log, and gets it back when it returns."""
        return False

    def runs(self) -> frozenset[str]:
        """Return nothing: every process has a row, or ends by itself."""
        return frozenset()

    def forget(self, run: str) -> None:
        """Do nothing, see `runs`."""

    def close(self) -> None:
        """Do nothing: processes are asked for, not watched."""


def _exists(handle: Handle) -> bool:
    """Return whether exactly the process of the handle still exists."""
    identity = process_identity(int(handle["pid"]))
    return identity is not None and identity == handle["identity"]


def _end_session(leader: int, is_ours: Callable[[psutil.Process], bool]) -> None:
    """Kill the remaining processes of a session whose leader is gone."""
    for process in psutil.process_iter():
        with contextlib.suppress(ProcessLookupError, PermissionError, psutil.Error):
            if os.getsid(process.pid) == leader and process.pid != leader and is_ours(process):
                process.kill()


def _run_of(process: psutil.Process) -> str | None:
    """Return the run that a process belongs to, by the environment it was started with."""
    try:
        given = json.loads(process.environ()["LAMBENT_RUN"])
        return run_name(given["job_id"], given["run"])
    except (psutil.Error, OSError, KeyError, ValueError, TypeError):
        return None
