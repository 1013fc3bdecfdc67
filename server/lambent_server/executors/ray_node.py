"""The actor that keeps a run process on a node of a Ray cluster.

Its class is sent to the node, which may have another version of Lambent: this module imports nothing of ours.
"""

import base64
import contextlib
import fcntl
import fnmatch
import glob
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

_SHARE_OF_MEMORY = 0.9
_LOG_PIECE_BYTES = 256 * 1024
_KEPT_AFTER_END_S = 600.0
"""How long an actor waits for a server that asks how its run ended."""
_STALE_AFTER_S = 3600.0
_CHECK_TIMEOUT_S = 60.0
# The kernel kills the run when the actor is gone: Ray would give its GPUs to another run.
_GUARD = """
import ctypes, os, signal, sys
ctypes.CDLL(None).prctl(1, signal.SIGKILL)
if os.getppid() != int(sys.argv[1]):
    os.kill(os.getpid(), signal.SIGKILL)
os.execvp(sys.argv[2], sys.argv[2:])
"""


class RunHolder:
    """Starts one run process and says how it is; killed, it takes the process with it."""

    def __init__(self, launch: dict[str, Any]) -> None:
        self._launch = launch
        self._child: subprocess.Popen[bytes] | None = None
        self._exit_code: int | None = None
        self._refused = ""
        self._lock: Any = None
        self._gpus: list[int] = []
        self._node = ""
        root = launch["folder"] or os.path.join(tempfile.gettempdir(), f"lambent-{os.getuid()}")
        self._root = Path(root) / launch["namespace"]
        self._folder = self._root / launch["job_id"]
        self._log = self._folder / f"run-{launch['run']}.log"
        try:
            self._begin()
        except (OSError, ValueError, subprocess.SubprocessError) as error:
            self._refused = f"{type(error).__name__}: {error}"

    def _begin(self) -> None:
        launch = self._launch
        _make_private(self._root.parent)
        self._root.mkdir(mode=0o700, exist_ok=True)
        with _locked(self._root / "lock"):
            _remove_stale(self._root)
            self._folder.mkdir(exist_ok=True)
            self._lock = (self._folder / f"run-{launch['run']}.lock").open("w")
            fcntl.flock(self._lock, fcntl.LOCK_EX)
        self._node, self._gpus = _given_place()
        environment = self._environment()
        command = [sys.executable if part is None else part for part in launch["command"]]
        self._refused = self._mismatch(command[0], environment)
        if self._refused:
            return
        with self._log.open("ab") as log:
            self._child = subprocess.Popen(
                [sys.executable, "-P", "-S", "-c", _GUARD, str(os.getpid()), *command],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                env=environment,
                start_new_session=True,
                pass_fds=[self._lock.fileno()],
            )
        threading.Thread(target=_leave_after, args=(self._child.pid,), daemon=True).start()

    def _environment(self) -> dict[str, str]:
        """Return the variables of the run: those of this node that runs may have, and what it is to do."""
        launch = self._launch
        environment = {
            name: value
            for name, value in os.environ.items()
            if any(fnmatch.fnmatchcase(name, pattern) for pattern in launch["environment"])
            and (name in launch["named"] or re.search(launch["secret"], name) is None)
        }
        # Set by Ray: the first to the processors that it counts, at most one for a run on a GPU.
        for name in ("OMP_NUM_THREADS", "PYTHONBREAKPOINT"):
            environment.pop(name, None)
        share = self._share()
        work_dir = self._folder / f"run-{launch['run']}"
        work_dir.mkdir(exist_ok=True)
        memory_bytes = launch["memory_bytes"]
        if memory_bytes is None:
            memory_bytes = int(_SHARE_OF_MEMORY * share * _memory_bytes())
        given = {**launch["identity"], "work_dir": str(work_dir), "memory_bytes": memory_bytes}
        environment["LAMBENT_RUN"] = json.dumps(given)
        environment["LAMBENT_SANDBOX"] = launch["sandbox"]
        environment["LAMBENT_RUN_SLOTS"] = str(max(1, round(1 / share)))
        environment["CUDA_VISIBLE_DEVICES"] = ",".join(map(str, self._gpus))
        return environment

    def _share(self) -> float:
        """Return the part of this machine that the run has: that of its processors or, if larger, GPUs."""
        processors = self._launch["needs"]["cpus"] / (os.cpu_count() or 1)
        devices = len(self._gpus) / max(len(glob.glob("/dev/nvidia[0-9]*")), 1)
        return float(min(max(processors, devices, 0.01), 1.0))

    def _mismatch(self, python: str, environment: dict[str, str]) -> str:
        """Return why the installed Lambent is not the one of the server; empty if it is."""
        wanted = self._launch["installed"]
        if wanted is None:
            return ""
        done = subprocess.run(
            [python, "-c", self._launch["installed_code"]],
            env=environment,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=_CHECK_TIMEOUT_S,
            check=False,
        )
        if done.returncode:
            return f"{python} does not run: {done.stderr.strip()[-300:]}"
        here = json.loads(done.stdout.splitlines()[-1])
        if here == wanted:
            return ""
        if not here["version"]:
            return f"Lambent with its extra [worker] is not installed for {python}"
        return (
            f"version {here['version']} ({here['digest'][:12]}) is installed for {python}, and the server "
            f"has {wanted['version']} ({wanted['digest'][:12]}); install the same wheel on both"
        )

    def status(self, offset: int) -> dict[str, Any]:
        """Return how the run is, and its output from `offset` on; -1 for none of it, so that all is left."""
        self._look()
        log, left = b"", 0
        if self._log.exists():
            if offset >= 0:
                with self._log.open("rb") as file:
                    file.seek(offset)
                    log = file.read(_LOG_PIECE_BYTES)
            left = max(self._log.stat().st_size - max(offset, 0) - len(log), 0)
        return {
            "node": self._node,
            "pid": self._child.pid if self._child else None,
            "exit_code": self._exit_code,
            "refused": self._refused,
            "gpus": self._gpus,
            "needs": self._launch["needs"],
            "offset": offset,
            "log": base64.b64encode(log).decode("ascii"),
            "log_left": left,
        }

    def signal(self, number: int) -> None:
        """Send a signal to the run process and its children."""
        self._look()
        if self._child is not None and self._exit_code is None:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self._child.pid, number)

    def leave(self) -> None:
        """End what there is of the run, remove its files from this node, and end."""
        if self._child is not None and self._exit_code is None:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self._child.pid, signal.SIGKILL)
            os.waitid(os.P_PID, self._child.pid, os.WEXITED | os.WNOWAIT)
            self._look()
        if self._lock is not None:
            with _locked(self._root / "lock"):
                self._lock.close()
                for path in self._folder.glob(f"run-{self._launch['run']}*"):
                    shutil.rmtree(path) if path.is_dir() else path.unlink()
                _remove_if_unused(self._folder)
        import ray

        ray.actor.exit_actor()

    def _look(self) -> None:
        """Notice the end of the run process, and end the rest of its session."""
        if self._child is None or self._exit_code is not None:
            return
        flags = os.WEXITED | os.WNOHANG | os.WNOWAIT
        if os.waitid(os.P_PID, self._child.pid, flags) is not None:
            # Not reaped yet, so no other process can have its pid.
            _end_session(self._child.pid)
            self._exit_code = self._child.wait()


def _given_place() -> tuple[str, list[int]]:
    """Return the node's identity and the GPUs that Ray has assigned."""
    import ray

    return ray.get_runtime_context().get_node_id(), [int(gpu) for gpu in ray.get_gpu_ids()]


def _memory_bytes() -> int:
    """Return the memory of this machine, or the limit of this container if it is lower."""
    total = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    with contextlib.suppress(OSError, ValueError):
        total = min(total, int(Path("/sys/fs/cgroup/memory.max").read_text(encoding="ascii")))
    return total


def _leave_after(pid: int) -> None:
    """End this process some time after the run process, in case no server asks any more."""
    with contextlib.suppress(ChildProcessError):
        os.waitid(os.P_PID, pid, os.WEXITED | os.WNOWAIT)
    time.sleep(_KEPT_AFTER_END_S)
    os._exit(0)


def _end_session(leader: int) -> None:
    """Kill the remaining processes of a session whose leader has ended."""
    for name in os.listdir("/proc"):
        with contextlib.suppress(OSError, ValueError):
            if int(name) != leader and os.getsid(int(name)) == leader:
                os.kill(int(name), signal.SIGKILL)


def _make_private(folder: Path) -> None:
    """Make a folder that no other user can enter; ValueError if it belongs to another user."""
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    state = folder.lstat()
    if state.st_uid != os.getuid() or state.st_mode & 0o022 or folder.is_symlink():
        raise ValueError(f"{folder} must be a folder of this user that no one else can write to")


@contextlib.contextmanager
def _locked(path: Path) -> Any:
    with path.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def _is_free(lock: Path) -> bool:
    """Return whether neither the actor nor the run process that held a lock exists."""
    with lock.open("a") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
    return True


def _remove_if_unused(folder: Path) -> None:
    if all(_is_free(lock) for lock in folder.glob("run-*.lock")):
        shutil.rmtree(folder, ignore_errors=True)


def _remove_stale(root: Path) -> None:
    """Remove folders whose actor was killed before it could."""
    for folder in root.iterdir():
        with contextlib.suppress(OSError):
            if folder.is_dir() and time.time() - folder.stat().st_mtime > _STALE_AFTER_S:
                _remove_if_unused(folder)
