"""Settings of the process that have to be made before torch is imported, and right after."""

import ctypes
import ctypes.util
import importlib
import os
import signal
import sys

from lambent_compute.threads import available_threads

_PR_SET_PDEATHSIG = 1
_PARENT = "LAMBENT_PARENT_PID"
_ALLOCATOR = {
    "MALLOC_MMAP_MAX_": (-4, 0),
    "MALLOC_TRIM_THRESHOLD_": (-1, 512 * 1024 * 1024),
    "MALLOC_TOP_PAD_": (-2, 64 * 1024 * 1024),
}
"""Settings of glibc's allocator: variables that a new process reads, the option's number, the value."""


def prepare(threads: int = 0) -> None:
    """Choose the number of cores to use and make waiting OpenMP threads sleep; call before torch is imported.

    `threads` 0 takes OMP_NUM_THREADS where it is set, else all cores there are, divided by LAMBENT_RUN_SLOTS,
    the number of runs among which the server divides the machine. Spinning threads make a step up to fifty
    times slower as soon as another process wants a core.
    """
    if "torch" in sys.modules and os.environ.get("OMP_WAIT_POLICY") != "PASSIVE":
        raise RuntimeError("lambent_core.startup.prepare must run before torch is imported")
    os.environ["OMP_WAIT_POLICY"] = "PASSIVE"
    os.environ["OMP_NUM_THREADS"] = str(threads or cores_in_use())
    _keep_memory()


def cores_in_use() -> int:
    """Return the number of cores to use: OMP_NUM_THREADS, else this run's share of the machine."""
    given = os.environ.get("OMP_NUM_THREADS", "")
    share = max(1, available_threads() // int(os.environ.get("LAMBENT_RUN_SLOTS", "1")))
    return int(given) if given.isdecimal() and int(given) else share


def ranks_in_use() -> int:
    """Return among how many processes the training of a run without GPUs is divided: LAMBENT_RANKS, else 1.

    For tests and rehearsals: on one machine's cores a run is faster by itself, with a process per core.
    """
    given = os.environ.get("LAMBENT_RANKS", "")
    return max(1, int(given)) if given.isdecimal() else 1


def with_parent() -> dict[str, str]:
    """Return this process's environment for a child that calls `end_with_parent`."""
    return os.environ | {_PARENT: str(os.getpid())}


def end_with_parent(number: int) -> None:
    """Let this process get a signal when the one that started it is gone (Linux).

    A process takes a second or more to come here. Its parent may be gone by then, and the process that
    inherited it looks like a parent: `with_parent` says which one is the true one.
    """
    if sys.platform.startswith("linux"):
        parent = int(os.environ.pop(_PARENT, os.getppid()))
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, number)
        if os.getppid() != parent:
            os.kill(os.getpid(), number)


def _keep_memory() -> None:
    """Let glibc keep freed blocks: page faults of large temporaries cost a third of a large batch's time."""
    if not sys.platform.startswith("linux"):
        return
    for name, (_, value) in _ALLOCATOR.items():
        os.environ[name] = str(value)  # For processes that this one starts.
    library = ctypes.CDLL(ctypes.util.find_library("c"))
    mallopt = getattr(library, "mallopt", None)
    if mallopt is None:  # Another C library, such as musl.
        return
    for option, value in _ALLOCATOR.values():
        mallopt(option, value)


def import_colmap() -> None:
    """Import pycolmap, and keep the handlers of signals that it would replace by its own.

    Its own print a stack and end the process, also on SIGTERM. Call in the main thread.
    """
    numbers = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)
    before = {number: signal.getsignal(number) for number in numbers}
    importlib.import_module("pycolmap").logging.minloglevel = 2
    for number, handler in before.items():
        if handler is not None:
            signal.signal(number, handler)
