"""Measure what a job costs the service: rows, bytes, requests and processor time, without its training.

    python -m benchmarks job_cost [--jobs 12] [--seconds 60] [--progress 1] [--postgres URL]

Runs `--jobs` jobs that take no time and as many that sleep for `--seconds`, with the intervals of
production: what a job costs in any case is that of the first; what a minute of it costs, the difference.
The scene is uploaded once for all, and every job is followed by an event stream. Bytes of captures,
checkpoints and bundles depend on the capture and are not measured here.
"""

import argparse
import contextlib
import json
import os
import re
import tempfile
import threading
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx2
from lambent_server.core.settings import Settings
from lambent_server.database.engine import Database
from lambent_server.database.schema import metadata
from sqlalchemy import func, select, text

from benchmarks.history import Subject, processes_of, processor_s
from benchmarks.service_load import database_on

QUICK = "--jobs 2 --seconds 3"
# Production values of what the servers of tests have shorter.
PRODUCTION = ("tick_s", "heartbeat_s", "lost_after_s", "stream_poll_s", "stream_ping_s", "preview_interval_s")
_REQUESTS = re.compile(r'^lambent_request_seconds_count\{.*route="([^"]*)".*\} ([0-9.e+]+)$', re.MULTILINE)


@dataclass(frozen=True, slots=True)
class Cost:
    """What was used between two looks."""

    rows: Counter[str]
    database_bytes: int
    log_bytes: int
    requests: Counter[str]
    events: int
    server_s: float
    postgres_s: float
    seconds: float


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the benchmark."""
    parser.add_argument("--jobs", type=int, default=12)
    parser.add_argument("--seconds", type=float, default=60.0, help="of each of the long jobs")
    parser.add_argument("--progress", type=float, default=1.0, help="LAMBENT_PROGRESS_INTERVAL_S")
    parser.add_argument("--postgres", help="such as postgresql://postgres@127.0.0.1:5432/postgres")


class Meter:
    """Looks at a server and its database."""

    def __init__(self, server: Any, database: Database, url: str | None) -> None:
        self._server = server
        self._database = database
        name = "" if url is None else url.rpartition("/")[2]
        self._subject = Subject(server=server, scene_id="", deep="", database=name)
        self._on_postgresql = url is not None

    def look(self) -> dict[str, Any]:
        """Return all sums as they are now."""
        processes = processes_of(self._subject)
        with self._database.read() as connection:
            rows = {
                table.name: connection.execute(select(func.count()).select_from(table)).scalar_one()
                for table in metadata.sorted_tables
            }
            if self._on_postgresql:
                size = "SELECT sum(pg_total_relation_size(relid)) FROM pg_stat_user_tables"
            else:
                size = "SELECT page_count * page_size FROM pragma_page_count, pragma_page_size"
            database_bytes = int(connection.execute(text(size)).scalar_one())
        found = _REQUESTS.findall(self._server.client.get("/metrics").text)
        requests: Counter[str] = Counter()
        for route, count in found:
            requests[route] += int(float(count))
        return {
            "rows": Counter(rows),
            "database_bytes": database_bytes,
            "log_bytes": sum(path.stat().st_size for path in (self._server.data / "runs").glob("*/*.log")),
            "requests": requests,
            # The first one is the server itself.
            "server_s": processor_s(processes[:1]),
            "postgres_s": processor_s(processes[1:]),
            "at": time.monotonic(),
        }


def cost(meter: Meter, server: Any, scene: str, jobs: int, seconds: float) -> Cost:
    """Return what this number of jobs used."""
    before = meter.look()
    ids = [
        server.submit(scene, num_steps=max(int(seconds / 0.25), 1), step_s=0.25, checkpoint_every=10**9)
        for _ in range(jobs)
    ]
    followers = [threading.Thread(target=follow, args=(server, each), daemon=True) for each in ids]
    for each in followers:
        each.start()
    # Asking would be what is measured: a stream says when its job has ended.
    for thread in followers:
        thread.join(timeout=600 + seconds)
    assert {server.job(each)["state"] for each in ids} == {"succeeded"}
    events = sum(len(server.events(each)) for each in ids)
    after = meter.look()
    return Cost(
        rows=Counter({name: after["rows"][name] - before["rows"][name] for name in after["rows"]}),
        database_bytes=after["database_bytes"] - before["database_bytes"],
        log_bytes=after["log_bytes"] - before["log_bytes"],
        requests=Counter(
            {name: after["requests"][name] - before["requests"][name] for name in after["requests"]}
        ),
        events=events,
        server_s=after["server_s"] - before["server_s"],
        postgres_s=after["postgres_s"] - before["postgres_s"],
        seconds=after["at"] - before["at"],
    )


def follow(server: Any, job: str) -> None:
    """Read the event stream of a job until it has ended, as the page of jobs does."""
    headers = {"Authorization": f"Bearer {server.key}"}
    with httpx2.stream(
        "GET", f"{server.url}/v1/events?job={job}", headers=headers, timeout=120, verify=False
    ) as stream:
        for line in stream.iter_lines():
            if line.startswith("data: ") and any(
                f'"state":"{state}"' in line.replace(" ", "") for state in ("succeeded", "failed")
            ):
                return


def idle(meter: Meter, seconds: float) -> dict[str, float]:
    """Return the processor time that a second without jobs takes, of server and PostgreSQL."""
    before = meter.look()
    time.sleep(seconds)
    after = meter.look()
    passed = after["at"] - before["at"]
    return {name: (after[name] - before[name]) / passed for name in ("server_s", "postgres_s")}


def main(options: argparse.Namespace) -> dict[str, Any]:
    """Measure and print the table."""
    from support.live_server import LiveServer

    settings: dict[str, Any] = {name: Settings.model_fields[name].default for name in PRODUCTION}
    settings |= {"local_slots": options.jobs, "progress_interval_s": options.progress}
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        url = stack.enter_context(database_on(options.postgres))
        if url is not None:
            settings["database"] = url
        server = stack.enter_context(LiveServer(folder / "data", **settings))
        database = Database(Settings(data=server.data, database=url).database_url)
        stack.callback(database.close)
        meter, scene = Meter(server, database, url), server.scene()
        # The first jobs compile statements and check the scene.
        cost(meter, server, scene, 1, 0.0)
        at_rest = idle(meter, min(options.seconds, 20.0))
        short = cost(meter, server, scene, options.jobs, 0.0)
        long = cost(meter, server, scene, options.jobs, options.seconds)
    result = figures(short, long, at_rest, options)
    print(table(result))
    print(f"\nat rest: {100 * sum(at_rest.values()):.1f} % of a core; load average: {os.getloadavg()[0]:.1f}")
    print("rows of a job that takes no time:", json.dumps(result["tables"]))
    print("requests of such a job:", json.dumps(result["routes"]))
    return result


def figures(
    short: Cost, long: Cost, at_rest: dict[str, float], options: argparse.Namespace
) -> dict[str, Any]:
    """Return the cost of a job that takes no time, and that of a further minute."""
    jobs, minutes = options.jobs, options.jobs * options.seconds / 60.0

    def pair(name: str) -> dict[str, float]:
        first, second = getattr(short, name), getattr(long, name)
        if isinstance(first, Counter):
            first, second = first.total(), second.total()
        if name in at_rest:
            first -= at_rest[name] * short.seconds
            second -= at_rest[name] * long.seconds
        return {"job": first / jobs, "minute": (second - first) / minutes}

    names = ("rows", "events", "database_bytes", "log_bytes", "requests", "server_s", "postgres_s")
    return {
        **{name: pair(name) for name in names},
        "tables": {name: round(count / jobs, 2) for name, count in short.rows.items() if count},
        "routes": {name: round(count / jobs, 2) for name, count in short.requests.items() if count},
    }


def table(result: dict[str, Any]) -> str:
    """Return the result as a table."""
    lines = ["| | a job | a minute of its run |", "| --- | --- | --- |"]
    shown = {
        "rows": ("rows in the database", 1, "{:.1f}"),
        "events": ("of these, events", 1, "{:.1f}"),
        "database_bytes": ("database, kB", 1e-3, "{:.1f}"),
        "log_bytes": ("log, kB", 1e-3, "{:.1f}"),
        "requests": ("REST requests", 1, "{:.1f}"),
        "server_s": ("processor of the server, ms", 1e3, "{:.0f}"),
        "postgres_s": ("processor of PostgreSQL, ms", 1e3, "{:.0f}"),
    }
    for name, (label, scale, text_format) in shown.items():
        values = (text_format.format(scale * result[name][key]) for key in ("job", "minute"))
        lines.append(f"| {label} | {' | '.join(values)} |")
    return "\n".join(lines)
