"""Limits on what the pipeline of a run may use of its machine, with and without a control group."""

import ctypes
import os
import resource
import sys
from pathlib import Path

from lambent_run.job.servers import Identity

_PR_SET_NO_NEW_PRIVS = 38


def limit_run(identity: Identity) -> None:
    """Limit this process and those that it starts for good: memory of each, sizes of files, and their number.

    Memory and processes on Linux only. Allocations and writes beyond a limit fail as if the machine had no
    more. None of them gets more rights than this one.
    """
    if identity.file_bytes:
        _lower(resource.RLIMIT_FSIZE, identity.file_bytes)
    if not sys.platform.startswith("linux"):
        return
    ctypes.CDLL(None).prctl(_PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0)
    _lower(resource.RLIMIT_CORE, 0)
    if identity.memory_bytes:
        # RLIMIT_DATA, not RLIMIT_AS: CUDA reserves far more addresses than there is memory.
        _lower(resource.RLIMIT_DATA, identity.memory_bytes)
    if identity.processes:
        # The system counts all threads of the user, not only those of this run.
        slots = int(os.environ.get("LAMBENT_RUN_SLOTS", "1"))
        _lower(resource.RLIMIT_NPROC, count_threads(os.getuid()) + slots * identity.processes)


def count_threads(user: int) -> int:
    """Return the number of threads that a user has on this system (Linux)."""
    total = 0
    for folder in Path("/proc").iterdir():
        if folder.name.isdecimal():
            try:
                if folder.stat().st_uid == user:
                    # The 20th value; the second is a name in parentheses, which may contain spaces.
                    total += int((folder / "stat").read_text(errors="replace").rpartition(")")[2].split()[17])
            except (OSError, IndexError, ValueError):
                continue
    return total


def _lower(kind: int, value: int) -> None:
    """Set a limit, or keep one that is lower already."""
    hard = resource.getrlimit(kind)[1]
    value = value if hard == resource.RLIM_INFINITY else min(value, hard)
    resource.setrlimit(kind, (value, value))
