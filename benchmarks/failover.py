"""Measure how fast another server leads when the leader is killed, and that no living run is restarted.

    python -m benchmarks failover [--jobs 50] [--kills 5] [--restarts 20]

Two servers on a PostgreSQL server that the benchmark makes itself and one folder of files, with all time-outs
as they are by default, and jobs that only sleep. Again and again the leader is killed (SIGKILL) and started
again once the other one leads and all runs have reported to it. Then PostgreSQL is stopped and started again.
At the end every job must have succeeded in its first run.
"""

import argparse
import contextlib
import os
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from lambent_server.core.settings import Settings
from sqlalchemy import create_engine, text
from support.live_server import FAST, LiveServer, wait_until
from support.own_postgresql import OwnPostgreSQL

QUICK = "--jobs 2 --kills 1 --restarts 1 --away 1 --wait 0"
KEPT = {"port", "local_slots", "disk_floor_bytes"}
"""Of the tests' settings; all others are those of a server."""
PATIENCE_S = 300.0


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the benchmark."""
    parser.add_argument("--jobs", type=int, default=50)
    parser.add_argument("--kills", type=int, default=5)
    parser.add_argument("--restarts", type=int, default=20, help="of PostgreSQL")
    parser.add_argument("--wait", type=float, default=90.0, help="seconds before the jobs may end")
    parser.add_argument("--away", type=float, default=5.0, help="seconds for which PostgreSQL is stopped")


class Watch:
    """Looks at the rows of servers and jobs."""

    def __init__(self, url: str) -> None:
        self._engine = create_engine(url.replace("postgresql:", "postgresql+psycopg:"), pool_pre_ping=True)

    def close(self) -> None:
        """Close the connections."""
        self._engine.dispose()

    def rows(self, statement: str, **given: Any) -> list[Any]:
        """Return what a query finds."""
        with self._engine.connect() as connection:
            return list(connection.execute(text(statement), given))

    def leader(self) -> str:
        """Return who leads; empty if nobody does."""
        found = self.rows(
            "SELECT holder FROM leadership WHERE expires_at >= extract(epoch FROM clock_timestamp())"
        )
        return str(found[0][0]) if found else ""

    def num_silent(self, since: float) -> int:
        """Return how many running jobs have not been heard of since a time."""
        statement = "SELECT count(*) FROM jobs WHERE state = 'running' AND coalesce(heartbeat_at, 0) < :since"
        return int(self.rows(statement, since=since)[0][0])


def _row(name: str, seconds: list[float]) -> str:
    if not seconds:
        return f"| {name} | none | | |"
    low, middle, high = (float(np.quantile(seconds, q)) for q in (0.0, 0.5, 1.0))
    return f"| {name} | {low:.1f} | {middle:.1f} | {high:.1f} |"


def main(args: argparse.Namespace) -> dict[str, Any]:
    """Run the benchmark and return its figures."""
    load = os.getloadavg()[0]
    with tempfile.TemporaryDirectory() as name, OwnPostgreSQL() as postgres:
        folder = Path(name)
        (folder / "store").mkdir()
        ordinary = {each: Settings.model_fields[each].default for each in FAST if each not in KEPT}
        given = {
            **ordinary,
            "database": postgres.url,
            "store": f"file://{folder}/store",
            "local_slots": -(-args.jobs // 2),
        }
        with (
            LiveServer(folder / "a", **given) as first,
            LiveServer(folder / "b", key=first.key, **given) as second,
            contextlib.closing(Watch(postgres.url)) as watch,
        ):
            found = _measure(args, (first, second), watch, postgres, folder / "end")
    found["load"] = [load, os.getloadavg()[0]]
    return found


def _measure(
    args: argparse.Namespace, servers: tuple[LiveServer, LiveServer], watch: Watch, postgres: Any, end: Path
) -> dict[str, Any]:
    first, _ = servers
    scene = first.scene()
    order = {"num_steps": 1_000_000, "step_s": 1.0, "checkpoint_every": 300, "until": end}
    jobs = [first.submit(scene, **order) for _ in range(args.jobs)]
    for job in jobs:
        first.wait_step(job, 1, timeout_s=PATIENCE_S)
    by_id = {(each.data / "server.id").read_text().strip(): each for each in servers}
    leads, heard, recovered = [], [], []
    for _ in range(args.kills):
        holder = wait_until(watch.leader, PATIENCE_S)
        killed, at, began = by_id[holder], time.time(), time.monotonic()
        killed.kill()
        # Reports that were under way count for the server that was killed.
        wait_until(lambda at=at: watch.num_silent(at + 0.1) == 0, PATIENCE_S)
        heard.append(time.monotonic() - began)
        wait_until(lambda holder=holder: watch.leader() not in ("", holder), PATIENCE_S)
        leads.append(time.monotonic() - began)
        killed.start()
    for _ in range(args.restarts):
        postgres.stop()
        time.sleep(args.away)
        postgres.start()
        at, began = time.time(), time.monotonic()
        wait_until(lambda at=at: watch.num_silent(at) == 0 and watch.leader(), PATIENCE_S)
        recovered.append(time.monotonic() - began)
    # Whatever counts as lost by then has been restarted.
    time.sleep(args.wait)
    end.touch()
    finals = [first.wait(job, timeout_s=PATIENCE_S) for job in jobs]
    restarted = sum(job["run"] != 1 for job in finals)
    failed = sum(job["state"] != "succeeded" for job in finals)
    print(f"{args.jobs} jobs, {args.kills} kills of the leader, {args.restarts} restarts of PostgreSQL")
    print("| seconds | least | median | most |\n| --- | --- | --- | --- |")
    print(_row("kill to the next leader", leads))
    print(_row("kill until all runs were heard by the other server", heard))
    print(_row("start of PostgreSQL until all runs were heard and a server led", recovered))
    print(f"jobs restarted: {restarted}, jobs that did not succeed: {failed}")
    return {
        "leader_s": leads,
        "heard_s": heard,
        "recovered_s": recovered,
        "restarted": restarted,
        "failed": failed,
    }
