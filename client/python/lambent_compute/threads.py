"""Work in threads, for code that releases the interpreter lock."""

import os
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")


def available_threads(quota: Path = Path("/sys/fs/cgroup/cpu.max")) -> int:
    """Return the number of CPU threads this process may use: its affinity, or its container's quota."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    with suppress(OSError, ValueError):  # Not there, or "max" without a limit.
        allowed, period = quota.read_text(encoding="ascii").split()
        cores = min(cores, max(1, int(allowed) // int(period)))
    return cores


def in_order(
    work: Callable[[Item], Result], items: Sequence[Item], num_threads: int
) -> Generator[Result, None, None]:
    """Yield `work` of all items in their order, from `num_threads` threads.

    A caller that stops early, or fails, waits only for what was begun.
    """
    if num_threads == 1 or len(items) < 2:
        yield from map(work, items)
        return
    pool = ThreadPoolExecutor(num_threads)
    try:
        for future in [pool.submit(work, item) for item in items]:
            yield future.result()
    finally:
        pool.shutdown(cancel_futures=True)


def for_each(work: Callable[[Item], None], items: Sequence[Item], num_threads: int) -> None:
    """Call `work` with all items, in `num_threads` threads; raise what the first failing one raised."""
    for _ in in_order(work, items, num_threads):
        pass
