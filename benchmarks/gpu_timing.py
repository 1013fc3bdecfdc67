"""Times on a GPU by its own clock, and what there is to compare them with."""

import platform
import statistics
import subprocess
import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypedDict

import torch

FLUSH_BYTES = 2**30
"""Written before each timing: it empties the cache, and keeps the GPU busy while the host starts a kernel."""


class Spread(TypedDict):
    """Times of repeats in milliseconds."""

    median: float
    least: float
    largest: float
    repeats: int


def spread(milliseconds: list[float]) -> Spread:
    """Return median and range of times."""
    return Spread(
        median=statistics.median(milliseconds),
        least=min(milliseconds),
        largest=max(milliseconds),
        repeats=len(milliseconds),
    )


def timed(
    call: Callable[[], object], device: torch.device, repeats: int, *, warm_up: int = 3, cold: bool = False
) -> Spread:
    """Return the times of `call`: between events on a GPU, by the clock on the wall elsewhere.

    With `cold` the GPU's cache holds nothing of the arguments.
    """
    for _ in range(warm_up):
        call()
    if device.type != "cuda":
        times = []
        for _ in range(repeats):
            began = time.perf_counter()
            call()
            times.append(1e3 * (time.perf_counter() - began))
        return spread(times)
    flushed = torch.empty(FLUSH_BYTES if cold else 0, dtype=torch.uint8, device=device)
    pairs = []
    for _ in range(repeats):
        flushed.zero_()
        pair = torch.cuda.Event(enable_timing=True), torch.cuda.Event(enable_timing=True)
        pair[0].record()
        call()
        pair[1].record()
        pairs.append(pair)
    torch.cuda.synchronize(device)
    return spread([begin.elapsed_time(end) for begin, end in pairs])


def bandwidth(device: torch.device, size_bytes: int) -> float:
    """Return the bytes per second that a copy of `size_bytes` reads and writes."""
    source = torch.zeros(size_bytes, dtype=torch.uint8, device=device)
    target = torch.empty_like(source)
    return 2.0 * size_bytes / (1e-3 * timed(lambda: target.copy_(source), device, 10)["median"])


def machine(device: torch.device) -> dict[str, Any]:
    """Return a description of the machine, and of the revision that is measured where git knows it."""
    found: dict[str, Any] = {"system": platform.platform(), "torch": torch.__version__}
    if device.type == "cuda":
        properties = torch.cuda.get_device_properties(device)
        found |= {
            "gpu": properties.name,
            "capability": f"{properties.major}.{properties.minor}",
            "memory [GiB]": round(properties.total_memory / 2**30, 1),
            "multiprocessors": properties.multi_processor_count,
            "cuda": torch.version.cuda,
            "triton": version("triton"),
        }
    command = ["git", "-C", str(Path(__file__).parent), "rev-parse", "--short", "HEAD"]
    try:
        found["revision"] = subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        found["revision"] = "unknown"
    return found
