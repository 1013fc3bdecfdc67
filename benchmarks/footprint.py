"""Measure the start-up times, memory and sizes of the programs before they do any work.

    python -m benchmarks footprint [--bundle DIR]

The command line's help and the server's start are repeated five times; times are wall-clock seconds, the
median with its range. Memory is the resident set of the server and its children one second after it is ready.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import httpx2
import psutil

QUICK = "--bundle {bundle} --repeats 1"


def seconds_of_help() -> float:
    """Return how long `lambent --help` takes."""
    started = time.perf_counter()
    subprocess.run([sys.executable, "-m", "lambent", "--help"], check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - started


def server_start() -> tuple[float, float]:
    """Return the seconds until a fresh server answers that it is ready, and its idle memory [MiB]."""
    with tempfile.TemporaryDirectory() as folder:
        data = Path(folder)
        started = time.perf_counter()
        server = subprocess.Popen(
            [sys.executable, "-m", "lambent", "serve", "--data", data, "--port", "0"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        try:
            seconds = _wait_until_ready(data, started)
            time.sleep(1.0)
            family = [psutil.Process(server.pid), *psutil.Process(server.pid).children(recursive=True)]
            return seconds, sum(process.memory_info().rss for process in family) / 2**20
        finally:
            server.terminate()
            server.wait(15)


def _wait_until_ready(data: Path, started: float) -> float:
    while time.perf_counter() - started < 30:
        try:
            url = json.loads((data / "server.json").read_text())["url"]
            if httpx2.get(f"{url}/readyz").status_code == 200:
                return time.perf_counter() - started
        except (OSError, ValueError, httpx2.HTTPError):
            pass
        time.sleep(0.02)
    raise SystemExit("the server did not become ready within 30 s")


def show(name: str, values: list[float], unit: str) -> None:
    """Print a row of the table."""
    middle, low, high = statistics.median(values), min(values), max(values)
    print(f"| {name} | {middle:.2f} {unit} | {low:.2f} to {high:.2f} |")


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the benchmark."""
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--bundle", type=Path, help="a bundle whose files are to be weighed")


def main(arguments: argparse.Namespace) -> None:
    """Print the table."""
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    starts = [server_start() for _ in range(arguments.repeats)]
    print("| figure | median | range |\n| --- | --- | --- |")
    show("`lambent --help`", [seconds_of_help() for _ in range(arguments.repeats)], "s")
    show("server, start until ready", [seconds for seconds, _ in starts], "s")
    show("server, idle memory", [memory for _, memory in starts], "MiB")
    if arguments.bundle:
        size = sum(path.stat().st_size for path in arguments.bundle.rglob("*") if path.is_file())
        show("bundle on disk", [size / 1e6], "MB")
