"""Settings of the process that have to be made before torch is imported, and right after."""

import ctypes
import ctypes.util
import importlib
import os
import signal
import sys

_PR_SET_PDEATHSIG = 1


def prepare() -> None:
    """Make waiting OpenMP threads sleep; call before torch is imported.

    Spinning threads make a step up to fifty times slower as soon as another process wants a core.
    """
    if "torch" in sys.modules and os.environ.get("OMP_WAIT_POLICY") != "PASSIVE":
        raise RuntimeError("lambent_worker.startup.prepare must run before torch is imported")
    os.environ["OMP_WAIT_POLICY"] = "PASSIVE"
    _keep_memory()


def end_with_parent(number: int) -> None:
    """Let this process get a signal when the one that started it is gone (Linux)."""
    if sys.platform.startswith("linux"):
        parent = os.getppid()
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, number)
        if os.getppid() != parent:
            os.kill(os.getpid(), number)


def _keep_memory() -> None:
    """Let glibc keep freed blocks: page faults of large temporaries cost a third of a large batch's time."""
    if not sys.platform.startswith("linux"):
        return
    library = ctypes.CDLL(ctypes.util.find_library("c"))
    mallopt = getattr(library, "mallopt", None)
    if mallopt is None:  # Another C library, such as musl.
        return
    trim_threshold, top_pad, mmap_max = -1, -2, -4
    mallopt(mmap_max, 0)
    mallopt(trim_threshold, 512 * 1024 * 1024)
    mallopt(top_pad, 64 * 1024 * 1024)


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
