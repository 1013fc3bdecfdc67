"""Faults of every kind, in random order, while jobs come and go; afterwards the promises must hold.

`LAMBENT_CHAOS_FAULTS` is how many there are, `LAMBENT_CHAOS_SEED` their order, `LAMBENT_CHAOS_PAUSE_S` the
mean time between two, and `LAMBENT_CHAOS_JOB_EVERY_S` that between two jobs; `make chaos` has the long form.
`LAMBENT_CHAOS_SERVER_EVERY` is how many faults lie between two that end the server: without it these come
as often as others, and with it a server lives long enough to see whether its memory grows (`make soak`).
"""

import contextlib
import json
import os
import random
import signal
import sqlite3
import statistics
import threading
import time
import uuid
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx2
import psutil
import pytest
from lambent_server.serving import free_port
from lambent_server.storage.s3 import S3Options
from lambent_server.storage.store import BlobStore
from sqlalchemy import create_engine
from support.flipped_bits import FlippedBits
from support.invariants import broken
from support.live_server import FINAL, LiveServer, wait_until
from support.own_postgresql import OwnPostgreSQL
from support.s3_server import S3Server, with_credentials
from support.set_clock import SetClock

pytestmark = pytest.mark.slow
FAULTS = int(os.environ.get("LAMBENT_CHAOS_FAULTS", "8"))
SEED = int(os.environ.get("LAMBENT_CHAOS_SEED", "0"))
PAUSE_S = float(os.environ.get("LAMBENT_CHAOS_PAUSE_S", "0.4"))
JOB_EVERY_S = float(os.environ.get("LAMBENT_CHAOS_JOB_EVERY_S", "0.5"))
AWAY_S = float(os.environ.get("LAMBENT_CHAOS_AWAY_S", "1.5"))
SERVER_EVERY = int(os.environ.get("LAMBENT_CHAOS_SERVER_EVERY", "0"))
ENDS_OF_SERVERS = (
    "the server killed",
    "the server ended",
    "the clock set while the server is down",
    "a bit flipped while the server is down",
)
CLOCK_JUMP_S = 600
UNLIMITED = 1_000_000
ORPHAN_AFTER_S = 4.0
SETTINGS = {
    "max_losses": UNLIMITED,
    "max_losses_without_checkpoint": UNLIMITED,
    "max_queued_jobs": UNLIMITED,
    "orphan_after_s": ORPHAN_AFTER_S,
    "lost_after_s": 2.0,
    "stall_after_s": 60.0,
}


@dataclass
class World(FlippedBits):
    """A server, what it stands on, and the jobs that it has accepted."""

    server: LiveServer
    database: str
    store: BlobStore
    clock: SetClock
    postgresql: OwnPostgreSQL | None = None
    s3: S3Server | None = None
    accepted: list[str] = field(default_factory=list)
    broken_off: bool = False
    """Whether the test has failed, so that nobody waits for a server that is not there."""
    folder: Path = field(default_factory=Path)
    """Of the bytes in the store, where it is one."""
    spare: bytes = b""
    """A file of a capture that no job uses."""
    done: Counter[str] = field(default_factory=Counter)
    choice: random.Random = field(default_factory=lambda: random.Random(SEED))  # noqa: S311

    def submit_until(self, ended: threading.Event, scene: str) -> None:
        """Submit jobs, each again under the same key until it is accepted."""
        headers = {"Authorization": f"Bearer {self.server.key}"}
        params = {"num_steps": "25", "step_s": "0.04", "checkpoint_every": "6"}
        body = {"scene_id": scene, "preset": "tiny", "params": params}
        with httpx2.Client(base_url=self.server.url, headers=headers, timeout=20.0, verify=False) as client:
            while not ended.wait(JOB_EVERY_S):
                once = {"Idempotency-Key": uuid.uuid4().hex}
                while not self.broken_off:
                    with contextlib.suppress(httpx2.HTTPError):
                        answer = client.post("/v1/jobs", json=body, headers=once)
                        if answer.status_code == 202:
                            self.accepted.append(answer.json()["id"])
                            break
                        assert answer.status_code in (500, 503), answer.text
                    time.sleep(0.1)

    def jobs(self) -> dict[str, dict[str, Any]]:
        """Return every job by its id."""
        found: dict[str, dict[str, Any]] = {}
        cursor = ""
        while True:
            page = self.server.client.get(f"/v1/jobs?limit=100{cursor}").raise_for_status().json()
            found |= {job["id"]: job for job in page["items"]}
            if not page["next_cursor"]:
                return found
            cursor = f"&cursor={page['next_cursor']}"

    def broken(self) -> list[str]:
        """Return the promises that do not hold."""
        engine = create_engine(self.database)
        logs = self.server.data.parent.glob("data-server-*.log")
        with engine.connect() as connection:
            found = broken(connection, self.store, self.accepted, logs)
        engine.dispose()
        return found

    def alive(self) -> list[psutil.Process]:
        """Return the run processes, which may be ending."""
        return self.server.run_processes()

    def kinds(self) -> dict[str, Callable[[], None]]:
        """Return the faults that are possible here."""
        possible: dict[str, Callable[[], None]] = {
            "a process of a run killed": self.kill_one,
            "a whole run killed": self.kill_run,
            "a run asked to end from outside": self.end_run,
            "a run stopped for a while": self.freeze_run,
            "the server killed": self.kill_server,
            "the server ended": self.end_server,
            "the clock set back": lambda: self.set_clock(-CLOCK_JUMP_S),
            "the clock set forward": lambda: self.set_clock(CLOCK_JUMP_S),
            "the clock set while the server is down": self.set_clock_between,
            "a bit of a checkpoint flipped": self.flip_checkpoint,
            "a bit of a capture flipped": self.flip_capture,
            "a bit flipped while the server is down": self.flip_between,
        }
        if self.postgresql is not None:
            possible["PostgreSQL stopped"] = self.stop_postgresql
        else:
            possible["the database locked"] = self.lock_database
        if self.s3 is not None:
            possible["the store unavailable"] = self.take_store_away
        return possible

    def set_clock(self, seconds: int) -> None:
        """Set the clock of the server by ten minutes, and at most so far from the right time."""
        there = self.clock.offset_s + seconds
        self.clock.set(there if abs(there) <= CLOCK_JUMP_S else 0)

    def set_clock_between(self) -> None:
        self.server.kill()
        self.set_clock(self.choice.choice([-1, 1]) * CLOCK_JUMP_S)
        self.server.start()

    def kill_one(self) -> None:
        alive = self.alive()
        if alive:
            self.choice.choice(alive).kill()

    def _group(self, number: int) -> int | None:
        """Signal the processes of one run, and return their group."""
        alive = self.server.run_processes("run")
        if not alive:
            return None
        group = self.choice.choice(alive).pid
        with contextlib.suppress(ProcessLookupError):
            os.killpg(group, number)
        return group

    def kill_run(self) -> None:
        self._group(signal.SIGKILL)

    def end_run(self) -> None:
        self._group(signal.SIGTERM)

    def freeze_run(self) -> None:
        group = self._group(signal.SIGSTOP)
        if group is not None:
            # Longer than it takes to count as lost.
            time.sleep(1.5 * SETTINGS["lost_after_s"])
            with contextlib.suppress(ProcessLookupError):
                os.killpg(group, signal.SIGCONT)

    def kill_server(self) -> None:
        self.server.kill()
        time.sleep(self.choice.uniform(0.0, 1.0))
        self.server.start()

    def end_server(self) -> None:
        assert self.server.end(self.choice.choice([signal.SIGTERM, signal.SIGINT])) < 30
        self.server.start()

    def lock_database(self) -> None:
        path = self.server.data / "lambent.sqlite"
        with contextlib.closing(sqlite3.connect(path, timeout=10, isolation_level=None)) as database:
            database.execute("BEGIN IMMEDIATE")
            time.sleep(1.0)
            database.execute("ROLLBACK")

    def stop_postgresql(self) -> None:
        assert self.postgresql is not None
        self.postgresql.stop(self.choice.choice(["immediate", "fast"]))
        time.sleep(self.choice.uniform(0.0, AWAY_S))
        self.postgresql.start()

    def take_store_away(self) -> None:
        assert self.s3 is not None
        self.s3.kill()
        time.sleep(self.choice.uniform(0.0, AWAY_S))
        self.s3.start()


@dataclass
class Life:
    """The memory of one server process: resident MiB after it has settled, and in its last minutes."""

    minutes: float
    settled_mib: float
    last_mib: float
    most_mib: float


@dataclass
class MemoryLog:
    """The resident memory of every server process over time."""

    server: LiveServer
    samples: dict[int, list[tuple[float, float]]] = field(default_factory=dict)
    settle_s: float = 300.0

    def watch_until(self, ended: threading.Event) -> None:
        """Take a sample every five seconds."""
        while not ended.wait(5.0):
            process = self.server.process
            with contextlib.suppress(psutil.Error):
                if process is not None:
                    mib = psutil.Process(process.pid).memory_info().rss / 2**20
                    self.samples.setdefault(process.pid, []).append((time.monotonic(), mib))

    def lives(self) -> list[Life]:
        """Return the memory of those processes that lived for at least three times `settle_s`."""
        found = []
        for samples in self.samples.values():
            began, ended = samples[0][0], samples[-1][0]
            if ended - began < 3 * self.settle_s:
                continue
            settled = [mib for at, mib in samples if self.settle_s <= at - began < 2 * self.settle_s]
            last = [mib for at, mib in samples if ended - at < self.settle_s]
            found.append(
                Life(
                    minutes=(ended - began) / 60.0,
                    settled_mib=statistics.median(settled),
                    last_mib=statistics.median(last),
                    most_mib=max(mib for _, mib in samples),
                )
            )
        return found


def order_of(kinds: list[str], choice: random.Random) -> list[str]:
    """Return which faults come: each kind once, before chance decides."""
    order = choice.sample(kinds, len(kinds))
    usual = [kind for kind in kinds if not SERVER_EVERY or kind not in ENDS_OF_SERVERS]
    for number in range(1, FAULTS - len(order) + 1):
        ends = SERVER_EVERY and number % SERVER_EVERY == 0
        order.append(choice.choice(ENDS_OF_SERVERS if ends else usual))
    return order


@pytest.fixture
def world(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[World]:
    with contextlib.ExitStack() as stack:
        settings: dict[str, Any] = {**SETTINGS, "port": free_port("127.0.0.1")}
        data = tmp_path / "data"
        postgresql, s3, options = None, None, None
        if "postgresql" in request.param:
            postgresql = stack.enter_context(OwnPostgreSQL())
            settings["database"] = postgresql.url
        if "s3" in request.param:
            stack.enter_context(with_credentials())
            s3 = stack.enter_context(S3Server(tmp_path / "s3"))
            s3.client().create_bucket(Bucket="bucket")
            settings |= {"store": "s3://bucket/chaos", "store_endpoint": s3.url, "store_region": "us-east-1"}
            options = S3Options(url="s3://bucket/chaos", endpoint=s3.url, region="us-east-1")
        clock = SetClock(tmp_path / "clock")
        settings["environment"] = clock.environment
        settings["scrub_every_s"] = 2.0
        server = stack.enter_context(LiveServer(data, **settings))
        store = BlobStore(data / "store", s3=options)
        sqlite = f"sqlite:///{data / 'lambent.sqlite'}"
        url = sqlite if postgresql is None else postgresql.url.replace("postgresql:", "postgresql+psycopg:")
        world = World(server, url, store, clock, postgresql, s3, folder=data / "store")
        world.spare = world.choice.randbytes(300_000)
        yield world


@pytest.mark.timeout(300 + 60 * FAULTS)
@pytest.mark.parametrize(
    "world",
    [
        "sqlite",
        pytest.param("postgresql", marks=pytest.mark.services),
        pytest.param("postgresql and s3", marks=[pytest.mark.services, pytest.mark.long]),
    ],
    indirect=True,
)
def test_promises_hold_after_faults_of_every_kind(world: World):
    scene, ended = world.server.scene(), threading.Event()
    world.push_spare()
    submitter = threading.Thread(target=world.submit_until, args=(ended, scene))
    memory = MemoryLog(world.server)
    watcher = threading.Thread(target=memory.watch_until, args=(ended,))
    began = time.monotonic()
    submitter.start()
    watcher.start()
    try:
        kinds = world.kinds()
        for kind in order_of(sorted(kinds), world.choice):
            kinds[kind]()
            world.done[kind] += 1
            time.sleep(world.choice.uniform(0.0, 2 * PAUSE_S))
    except BaseException:
        world.broken_off = True
        raise
    finally:
        ended.set()
        submitter.join()
        watcher.join()
    settled(world)
    jobs = world.jobs()
    counts = Counter(job["state"] for job in jobs.values())
    runs = sum(job["run"] for job in jobs.values())
    print(
        f"\n{world.done.total()} faults in {time.monotonic() - began:.0f} s: {dict(world.done)}\n"
        f"{len(world.accepted)} jobs accepted, {dict(counts)}, {runs} runs"
    )
    for life in memory.lives():
        print(life)
        # What a server learns in its first minutes is kept; what comes later must not be.
        assert life.last_mib < 1.1 * life.settled_mib, "memory grows"
    assert set(jobs) == set(world.accepted), "one accepted twice, or lost"
    assert counts == {"succeeded": len(jobs)}
    assert runs > len(jobs), "no fault hit a run"
    world.clock.set(0)
    # What was in transit when a process was killed is removed at the next start, once it is old enough.
    time.sleep(ORPHAN_AFTER_S)
    world.end_server()
    with contextlib.suppress(AssertionError):  # What remains is named below.
        wait_until(lambda: not remains(world.broken()), timeout_s=30.0)
    found = world.broken()
    assert not found, "\n".join(found)
    assert world.alive() == []
    assert [path for path in (world.server.data / "scratch").iterdir() if path.is_file()] == []


def settled(world: World) -> None:
    """Wait until every job has ended; raises AssertionError where none ends in three minutes."""
    left, changed_at = len(world.accepted), time.monotonic()
    while left:
        with contextlib.suppress(httpx2.HTTPError):
            unfinished = [name for name, job in world.jobs().items() if job["state"] not in FINAL]
            if len(unfinished) != left:
                left, changed_at = len(unfinished), time.monotonic()
        if time.monotonic() - changed_at > 180.0:
            server = world.server
            stuck = [server.job(name) | {"history": server.events(name)[-4:]} for name in unfinished[:3]]
            raise AssertionError(json.dumps(stuck, indent=1))
        time.sleep(0.2)


def remains(found: list[str]) -> list[str]:
    """Return those of what is broken that a sweep may repair."""
    return [line for line in found if line.startswith(("bytes without", "deletions", "P4 ended without"))]
