"""Measure a server with a million ended jobs and a long queue beside one with a thousand jobs and no queue.

    python -m benchmarks history [--old 1000000] [--queued 10000] [--databases sqlite postgresql]

Both servers run at once, and the same request goes to each in turn, so that a busy machine slows both. The
small database has the jobs that fill the same pages. On both servers one job is running, which does nothing.
"""

import argparse
import base64
import contextlib
import statistics
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import psutil
from lambent_server.core.settings import Settings
from lambent_server.database.engine import Database

QUICK = "--old 3000 --queued 100 --rounds 2 --idle 2 --databases sqlite"
SMALL = 1000
TIMES = 10
"""Requests of a kind in each round."""
NUM_STREAMS = 5
# Production values of what the servers of tests have shorter.
NAMES = (
    "tick_s",
    "heartbeat_s",
    "lost_after_s",
    "stream_poll_s",
    "stream_ping_s",
    "garbage_after_s",
    "local_slots",
)
NOTHING = [sys.executable, "-c", "import time; time.sleep(1e6)"]


@dataclass
class Subject:
    """A server that is measured."""

    server: Any
    scene_id: str
    deep: str
    database: str
    times_s: dict[str, list[float]] = field(default_factory=dict)
    """Of every request, by name."""
    processor_s: dict[str, float] = field(default_factory=dict)
    """Of the server and its database together, while requests of a name were sent."""


def _get(**given: Any) -> Callable[[Subject], Any]:
    return lambda subject: subject.server.client.get("/v1/jobs", params={"limit": 50, **given})


REQUESTS: dict[str, Callable[[Subject], Any]] = {
    "submit": lambda subject: subject.server.client.post(
        "/v1/jobs", json={"scene_id": subject.scene_id, "preset": "tiny", "gpus": 0, "labels": {"by": "me"}}
    ),
    "list": _get(),
    "list, far down": lambda subject: _get(cursor=subject.deep)(subject),
    "failed": _get(state="failed"),
    "unfinished": _get(state=["queued", "running", "cancelling", "retry_wait"]),
    "as the page lists them": _get(kind=["train", "prepare", "bake", "render", "batch"]),
    "failed pictures": _get(kind=["render", "batch"], state="failed"),
    "label": _get(label="project=p0"),
    "label, failed": _get(label="project=p0", state="failed"),
    "scene's name": _get(q="capture 17 of"),
    "part of every name": _get(q="kettle"),
    "preset": _get(q="stand"),
    "nothing found": _get(q="zzz"),
    "bundles": lambda subject: subject.server.client.get("/v1/bundles", params={"limit": 50}),
    "estimate": lambda subject: subject.server.client.post("/v1/estimates", json={"preset": "tiny"}),
    "metrics": lambda subject: subject.server.client.get("/metrics"),
}


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the benchmark."""
    parser.add_argument("--old", type=int, default=1_000_000, help="ended jobs (default: %(default)s)")
    parser.add_argument("--queued", type=int, default=10_000, help="queued jobs (default: %(default)s)")
    parser.add_argument("--rounds", type=int, default=20, help="rounds of ten requests of each kind")
    parser.add_argument("--idle", type=float, default=30.0, help="seconds for which idle servers are watched")
    parser.add_argument(
        "--databases", nargs="+", choices=("sqlite", "postgresql"), default=["sqlite", "postgresql"]
    )
    parser.add_argument("--scratch", type=Path, help="folder for the databases; 4 GB for a million jobs")


@contextlib.contextmanager
def started(folder: Path, dialect: str, num_old: int, num_queued: int) -> Iterator[Subject]:
    """Yield a server on a database with history."""
    from support.databases import postgresql
    from support.live_server import LiveServer
    from support.old_jobs import fill, identifier

    with contextlib.ExitStack() as stack:
        data = folder / f"{dialect}-{num_old}"
        data.mkdir()
        url = stack.enter_context(postgresql()) if dialect == "postgresql" else None
        defaults = {name: Settings.model_fields[name].default for name in NAMES}
        given = {"local_gpus": 0, "max_queued_jobs": 1_000_000, "stall_after_s": 1e9, "run_command": NOTHING}
        given |= defaults | ({"database": url} if url else {})
        database = Database(Settings(data=data, database=url).database_url)
        began = time.perf_counter()
        database.migrate()
        fill(database, num_old, num_queued, end=time.time() - 100)
        database.close()
        print(f"{dialect}: {num_old} old jobs written in {time.perf_counter() - began:.0f} s", flush=True)
        server = stack.enter_context(LiveServer(data, **given))
        scene_id = server.scene()
        server.wait(server.submit(scene_id), "running")
        deep = base64.urlsafe_b64encode(identifier("job", num_old // 4).encode()).decode().rstrip("=")
        yield Subject(server, scene_id, deep, url.rpartition("/")[2] if url else "")


def measure(subjects: list[Subject], rounds: int) -> None:
    """Send every request to each server in turn; the first round only warms them."""
    for number in range(rounds + 1):
        processes = [processes_of(each) for each in subjects]
        for name, request in REQUESTS.items():
            before = [processor_s(each) for each in processes]
            for _ in range(TIMES):
                for subject in subjects:
                    began = time.perf_counter()
                    answer = request(subject)
                    taken_s = time.perf_counter() - began
                    answer.raise_for_status()
                    if number:
                        subject.times_s.setdefault(name, []).append(taken_s)
            for subject, each, at in zip(subjects, processes, before, strict=True):
                if number:
                    sums = subject.processor_s
                    sums[name] = sums.get(name, 0.0) + processor_s(each) - at


def processes_of(subject: Subject) -> list[psutil.Process]:
    """Return the process of a server, and those of PostgreSQL that serve it."""
    server = psutil.Process(subject.server.process.pid)
    if not subject.database:
        return [server]
    found = psutil.process_iter(["name", "cmdline"])
    return [server] + [
        each
        for each in found
        if each.info["name"] == "postgres" and subject.database in " ".join(each.info["cmdline"] or ())
    ]


def processor_s(processes: list[psutil.Process]) -> float:
    """Return the processor time of processes; those that have ended count nothing."""
    total = 0.0
    for each in processes:
        with contextlib.suppress(psutil.Error):
            total += sum(each.cpu_times()[:2])
    return total


def idle_percent(subjects: list[Subject], seconds: float) -> list[float]:
    """Return how much of a core each server takes while streams of events are open and nothing happens."""
    from support.live_server import stream

    def follow(subject: Subject) -> None:
        with contextlib.suppress(Exception):
            for _ in stream(subject.server.url, subject.server.key, []):
                pass

    for subject in subjects:
        for _ in range(NUM_STREAMS):
            threading.Thread(target=follow, args=(subject,), daemon=True).start()
    time.sleep(min(seconds, 5.0))
    processes = [processes_of(each) for each in subjects]
    began, before = time.perf_counter(), [processor_s(each) for each in processes]
    time.sleep(seconds)
    taken_s = time.perf_counter() - began
    return [100 * (processor_s(each) - at) / taken_s for each, at in zip(processes, before, strict=True)]


def percentile(times_s: list[float], percent: float) -> float:
    """Return a percentile in milliseconds."""
    return 1000 * sorted(times_s)[min(int(percent / 100 * len(times_s)), len(times_s) - 1)]


def main(options: argparse.Namespace) -> dict[str, Any]:
    """Print a table for each database and return what is in it."""
    record: dict[str, Any] = {}
    if options.scratch is not None:
        options.scratch.mkdir(parents=True, exist_ok=True)
    for dialect in options.databases:
        with tempfile.TemporaryDirectory(dir=options.scratch) as folder, contextlib.ExitStack() as stack:
            sizes = ((SMALL, 0), (options.old, options.queued))
            subjects = [stack.enter_context(started(Path(folder), dialect, *size)) for size in sizes]
            measure(subjects, options.rounds)
            idle = idle_percent(subjects, options.idle)
        print(
            f"\n{dialect}: milliseconds after {SMALL} jobs, after {options.old} and {options.queued} queued\n"
        )
        print("| request | median | median | ratio | 99 % | 99 % | processor | processor |")
        print("| --- " * 8 + "|")
        record[dialect] = {"idle_percent": idle, "requests": {}}
        for name in REQUESTS:
            medians = [1000 * statistics.median(each.times_s[name]) for each in subjects]
            worst = [percentile(each.times_s[name], 99) for each in subjects]
            processor = [1000 * each.processor_s[name] / len(each.times_s[name]) for each in subjects]
            ratio = medians[1] / medians[0]
            found = {"median_ms": medians, "p99_ms": worst, "processor_ms": processor, "ratio": ratio}
            record[dialect]["requests"][name] = found
            cells = [f"{ms:.1f}" for ms in medians] + [f"{ratio:.2f}"] + [f"{ms:.0f}" for ms in worst]
            print(f"| {name} | {' | '.join(cells + [f'{ms:.1f}' for ms in processor])} |")
        print(f"\nidle, {NUM_STREAMS} streams: {idle[0]:.1f} % and {idle[1]:.1f} % of a core\n", flush=True)
    return record
