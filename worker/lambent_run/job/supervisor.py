"""The parent of a run process: sends heartbeats while its child works, and reports why the child died."""

import contextlib
import os
import signal
import socket
import subprocess
import sys
import threading
import time
import uuid
from collections.abc import Sequence
from pathlib import Path
from types import FrameType

from lambent_core.startup import with_parent
from lambent_proto.v1 import worker_pb2

from lambent_run.job.connection import (
    EXIT_FENCED,
    EXIT_UNREACHABLE,
    Connection,
    FencedError,
    RefusedError,
    UnreachableError,
)
from lambent_run.job.servers import Identity

FIRST_HEARTBEAT_S = 1.0
FENCED_GRACE_S = 1.0
"""Time for a child to end by itself where the run has ended: the child may have reported that end itself."""


def supervise(child_command: Sequence[str]) -> int:
    """Start the child and watch it to its end; return the exit code.

    The heartbeat must not come from the process that trains: one long step would look like death.
    """
    identity = Identity.from_environment()
    connection = Connection(identity)
    oom_kills = count_oom_kills()
    child = subprocess.Popen(list(child_command), stdin=subprocess.DEVNULL, env=with_parent())

    def pass_on(number: int, _frame: FrameType | None) -> None:
        connection.ending = True
        with contextlib.suppress(ProcessLookupError):
            child.send_signal(number)

    signal.signal(signal.SIGTERM, pass_on)
    signal.signal(signal.SIGINT, pass_on)
    try:
        _watch(connection, child)
        return _tell(connection, child.returncode, oom_kills)
    except FencedError as error:
        with contextlib.suppress(subprocess.TimeoutExpired):
            if child.wait(FENCED_GRACE_S) == 0:
                return 0
        print(f"fenced: {error}", file=sys.stderr, flush=True)
        return EXIT_FENCED
    except UnreachableError as error:
        print(f"unreachable: {error}", file=sys.stderr, flush=True)
        return EXIT_UNREACHABLE
    except RefusedError as error:
        print(f"refused: {error}", file=sys.stderr, flush=True)
        return 1
    finally:
        if child.poll() is None:
            child.kill()
            child.wait()
        connection.close()


def _watch(connection: Connection, child: subprocess.Popen[bytes]) -> None:
    identity = connection.identity
    interval_s, registered, stopped = FIRST_HEARTBEAT_S, False, False
    heard_at = time.monotonic()
    while child.poll() is None:
        began = time.monotonic()
        if not registered:
            request = worker_pb2.RegisterRequest(
                fence=identity.fence,
                pid=os.getpid(),
                process_identity=process_identity(os.getpid()),
                host=socket.gethostname(),
            )
            reply = connection.once(connection.stub.Register, request)
            if reply is not None:
                registered, interval_s = True, reply.heartbeat_s
        else:
            reply = connection.once(
                connection.stub.Heartbeat, worker_pb2.HeartbeatRequest(fence=identity.fence)
            )
            # A server that did not answer may be replaced by one that does not know where this process is.
            registered = reply is not None
            if reply is not None and reply.stop and not stopped:
                stopped = True
                connection.ending = True
                _end(child, identity.stop_grace_s)
        if reply is None:
            _require_hope(identity, time.monotonic() - heard_at)
        else:
            heard_at = time.monotonic()
            connection.stub.learn(reply.servers)
        with contextlib.suppress(subprocess.TimeoutExpired):
            child.wait(max(interval_s - (time.monotonic() - began), 0.05))


def _end(child: subprocess.Popen[bytes], grace_s: float) -> None:
    """Ask the child to end, and kill it after the grace time: no server may be left that could.

    In a thread of its own, because heartbeats wait for servers that do not answer.
    """
    child.terminate()
    killing = threading.Timer(grace_s, child.kill)
    killing.daemon = True
    killing.start()


def _require_hope(identity: Identity, silent_s: float) -> None:
    """Raise `UnreachableError` where no server that wants this run can be expected any more."""
    if not identity.work_dir.is_dir():
        raise UnreachableError(f"no server answers and {identity.work_dir} is gone")
    if 0 < identity.give_up_after_s < silent_s:
        raise UnreachableError(f"no server has answered for {silent_s:.0f} s")


def _tell(connection: Connection, code: int, oom_kills_before: int) -> int:
    """Tell the server about a child that could not do so itself."""
    if code in (0, EXIT_FENCED, EXIT_UNREACHABLE):
        return code
    request = worker_pb2.FailRequest(fence=connection.identity.fence)
    if code == -signal.SIGKILL and count_oom_kills() > oom_kills_before:
        request.cause = worker_pb2.FAIL_CAUSE_OUT_OF_MEMORY
        request.code = "run.out_of_memory"
        request.message = "the system ended the run because memory ran out; take a smaller preset"
    elif code in (-signal.SIGKILL, -signal.SIGTERM, -signal.SIGINT, -signal.SIGHUP):
        request.cause = worker_pb2.FAIL_CAUSE_KILLED
        request.code = "run.killed"
        request.message = f"the pipeline was ended by {signal.Signals(-code).name}"
    else:
        request.cause = worker_pb2.FAIL_CAUSE_INTERNAL
        request.code = "run.crashed"
        how = signal.Signals(-code).name if code < 0 else f"code {code}"
        request.message = f"the pipeline ended with {how}; the log has the rest"
    connection.call(connection.stub.Fail, request)
    return 0


def count_oom_kills() -> int:
    """Return how many processes the kernel has ended for memory, in this group where it is known (Linux)."""
    for path in (own_group() / "memory.events", Path("/sys/fs/cgroup/memory.events"), Path("/proc/vmstat")):
        with contextlib.suppress(OSError, ValueError):
            for line in path.read_text(encoding="ascii").splitlines():
                name, _, value = line.partition(" ")
                if name == "oom_kill":
                    return int(value)
    return 0


def own_group(root: Path = Path("/sys/fs/cgroup"), own: Path = Path("/proc/self/cgroup")) -> Path:
    """Return the folder of the control group (version 2) of this process; `root` where there is none."""
    with contextlib.suppress(OSError, UnicodeError):
        for line in own.read_text(encoding="utf-8").splitlines():
            if line.startswith("0::"):
                return root / line.removeprefix("0::").lstrip("/")
    return root


def process_identity(pid: int) -> str:
    """Return what tells a process from every other one, just as the server's local executor does."""
    try:
        ticks = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()[19]
        boot = Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
        return f"{boot}:{Path('/proc/self/ns/pid').stat().st_ino}:{ticks}"
    except OSError:
        import psutil

        return f"{uuid.getnode():012x}:{psutil.Process(pid).create_time():.2f}"
