"""Measure how fast a server answers while it holds thousands of event streams and slow senders.

    python -m benchmarks service_load [--streams 2000] [--senders 400] [--seconds 60] [--postgres URL]

Starts a server on a temporary folder, with SQLite or in a database that it creates on the given
PostgreSQL and drops. One client asks for /healthz and submits jobs at a steady pace, before and while another
process holds the streams and senders. Half of the streams follow all jobs, half one job that reports progress
every second; half of the senders upload at 2 KiB/s, half send a byte per second, which the server ends after
30 s. All of them come from eight keys and loopback addresses. Every tenth round submits a job, which is an
event that half of the streams must receive.
"""

import argparse
import contextlib
import json
import os
import secrets
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
import psutil
from sqlalchemy import create_engine, text
from support.live_server import LiveServer

QUICK = "--streams 40 --senders 10 --seconds 3 --rate 10"
NUM_CLIENTS = 8
BYTES_PER_S = 2048
PATIENCE_S = 30.0
# The senders connect in this time; what is measured is the service that holds them.
SETTLE_S = 3.0


@dataclass
class Times:
    """Seconds of single requests."""

    health: list[float]
    submit: list[float]
    submitted_at: list[float]

    def row(self, name: str) -> list[float]:
        """Return median and 99th percentile in milliseconds."""
        return [1e3 * float(np.quantile(getattr(self, name), q)) for q in (0.5, 0.99)]


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the benchmark."""
    parser.add_argument("--streams", type=int, default=2000)
    parser.add_argument("--senders", type=int, default=400)
    parser.add_argument("--seconds", type=float, default=60.0, help="of each measurement")
    parser.add_argument("--rate", type=float, default=20.0, help="rounds per second")
    parser.add_argument("--postgres", help="such as postgresql://postgres@127.0.0.1:5432/postgres")


@contextlib.contextmanager
def database_on(admin_url: str | None) -> Iterator[str | None]:
    """Yield the URL of an empty database, or None for SQLite."""
    if admin_url is None:
        yield None
        return
    admin = create_engine(
        admin_url.replace("postgresql:", "postgresql+psycopg:"), isolation_level="AUTOCOMMIT"
    )
    name = f"lambent_{secrets.token_hex(6)}"
    with admin.connect() as connection:
        connection.execute(text(f"CREATE DATABASE {name}"))
    try:
        yield f"{admin_url.rpartition('/')[0]}/{name}"
    finally:
        with admin.connect() as connection:
            connection.execute(text(f"DROP DATABASE {name} WITH (FORCE)"))
        admin.dispose()


def measure(server: LiveServer, client: httpx2.Client, scene: str, seconds: float, rate: float) -> Times:
    """Return the times of requests at a steady pace, whatever the time of each."""
    times, began = Times([], [], []), time.perf_counter()
    for number in range(int(seconds * rate)):
        time.sleep(max(began + number / rate - time.perf_counter(), 0.0))
        sent = time.perf_counter()
        client.get("/healthz").raise_for_status()
        times.health.append(time.perf_counter() - sent)
        if number % 10 == 0:
            sent = time.perf_counter()
            answer = client.post("/v1/jobs", json={"scene_id": scene, "preset": "tiny"})
            times.submit.append(time.perf_counter() - sent)
            times.submitted_at.append(sent - began)
            answer.raise_for_status()
    return times


def cpu_s(process: psutil.Process) -> float:
    """Return the processor time of a process in seconds."""
    return process.cpu_times().user + process.cpu_times().system


def last_events(server: LiveServer, names: list[str]) -> dict[str, int]:
    """Return the number of the last event of each job."""
    return {name: server.job(name)["last_event"] for name in names}


def load(server: LiveServer, *, streams: int, senders: int, seconds: float, rate: float) -> dict[str, Any]:
    """Return the times without and with load, and what the streams received."""
    scene, slow_scene = server.scene(), server.client.post("/v1/scenes", json={"name": "slow"}).json()["id"]
    running = server.submit(scene, num_steps=10_000_000, step_s=0.1)
    server.wait_step(running, 1)
    keys = [
        server.client.post("/v1/keys", json={"name": f"client {number}"}).raise_for_status().json()["key"]
        for number in range(NUM_CLIENTS)
    ]
    own = {"Authorization": f"Bearer {server.key}"}
    assert server.process is not None
    process = psutil.Process(server.process.pid)
    order = {
        "url": server.url,
        "keys": keys,
        "addresses": [f"127.0.0.{number + 2}" for number in range(NUM_CLIENTS)],
        "streams": streams,
        "senders": senders,
        "job": running,
        "scene": slow_scene,
        "bytes_per_s": BYTES_PER_S,
        "patience_s": PATIENCE_S,
    }
    clients = subprocess.Popen(
        [sys.executable, str(Path(__file__).with_name("load_clients.py"))],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert clients.stdin is not None
    assert clients.stdout is not None
    try:
        with httpx2.Client(base_url=server.url, headers=own, timeout=60.0, verify=False) as client:
            measure(server, client, scene, min(seconds / 3.0, 3.0), rate)
            used = [cpu_s(process)]
            idle = measure(server, client, scene, seconds, rate)
            used.append(cpu_s(process))
            threads = process.num_threads()
            before = {job["id"] for job in server.client.get("/v1/jobs?limit=100").json()["items"]}
            clients.stdin.write(json.dumps(order) + "\n")
            clients.stdin.flush()
            opened = json.loads(clients.stdout.readline())
            time.sleep(min(SETTLE_S, seconds))
            used.append(cpu_s(process))
            busy = measure(server, client, scene, seconds, rate)
            used.append(cpu_s(process))
        with process.oneshot():
            held = {"files": process.num_fds(), "threads": process.num_threads() - threads}
            held["resident_mib"] = process.memory_info().rss // 2**20
        held["cpu_s"] = np.diff(used).round(2).tolist()
        new = newest(server, before)
        clients.stdin.write(json.dumps(last_events(server, [running, *new])) + "\n")
        clients.stdin.flush()
        received = json.loads(clients.stdout.readline())
    finally:
        clients.terminate()
        clients.wait()
        clients.stdin.close()
        clients.stdout.close()
    return {"idle": idle, "busy": busy, "submitted": len(new), "server": held, **opened, **received}


def newest(server: LiveServer, before: set[str]) -> list[str]:
    """Return the jobs that were submitted since."""
    ids: list[str] = []
    cursor = ""
    while True:
        page = server.client.get(f"/v1/jobs?limit=100{cursor}").raise_for_status().json()
        fresh = [job["id"] for job in page["items"] if job["id"] not in before]
        ids += fresh
        if len(fresh) < len(page["items"]) or not page["next_cursor"]:
            return ids
        cursor = f"&cursor={page['next_cursor']}"


def main(options: argparse.Namespace) -> dict[str, Any]:
    """Measure and print the table."""
    settings = {"local_slots": 1, "max_queued_jobs": 1_000_000, "heartbeat_s": 10.0, "lost_after_s": 60.0}
    settings |= {"tick_s": 0.5, "stream_poll_s": 1.0, "stream_ping_s": 15.0, "progress_interval_s": 1.0}
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        url = stack.enter_context(database_on(options.postgres))
        if url is not None:
            settings["database"] = url
        server = stack.enter_context(LiveServer(folder / "data", **settings))
        result = load(
            server,
            streams=options.streams,
            senders=options.senders,
            seconds=options.seconds,
            rate=options.rate,
        )
    print(table(result, options.streams))
    print(f"\nload average of the machine: {os.getloadavg()[0]:.1f}")
    return result


def table(result: dict[str, Any], streams: int) -> str:
    """Return the result as a table."""
    lines = ["| request | idle p50 ms | p99 | loaded p50 | p99 | p99 ratio |", "| --- " * 6 + "|"]
    for name, shown in (("health", "GET /healthz"), ("submit", "POST /v1/jobs")):
        idle, busy = result["idle"].row(name), result["busy"].row(name)
        figures = " | ".join(f"{value:.1f}" for value in (*idle, *busy))
        lines.append(f"| {shown} | {figures} | {busy[1] / idle[1]:.1f} |")
    held = result["server"]
    return "\n".join(
        [
            *lines,
            "",
            f"{result['open']} of {streams} streams opened in {result['opening_s']:.1f} s; "
            f"{result['complete']} got every event of {result['submitted']} submitted jobs; "
            f"{result['wrong']} events missing or twice",
            f"server: {held['files']} open files, {held['threads']:+d} threads, {held['resident_mib']} MiB; "
            f"processor seconds idle, opening, loaded: {held['cpu_s']}",
            f"responses: {result['counts']}",
        ]
    )
