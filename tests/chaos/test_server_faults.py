"""Faults of the server itself: kills, restarts, ends with open streams."""

import contextlib
import os
import re
import signal
import sqlite3
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import httpx2
import psutil
import pytest
from lambent_server.core.settings import ServeError
from lambent_server.serving import sole_user
from support.live_server import LiveServer, stream, wait_until

pytestmark = pytest.mark.slow
SERVER_KILLS = int(os.environ.get("LAMBENT_CHAOS_SERVER_KILLS", "1"))
SUBMIT_KILLS = int(os.environ.get("LAMBENT_CHAOS_SUBMIT_KILLS", "1"))


ENDLESS = {"num_steps": 100_000, "step_s": 0.05}


@dataclass(frozen=True, kw_only=True)
class Started:
    """A server that has just answered for the first time."""

    server: LiveServer
    busy_s: float
    """Processor time, which is the waiting time on an otherwise idle machine."""
    size_bytes: int
    libraries: str


@pytest.fixture(scope="module")
def started(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Started]:
    with LiveServer(tmp_path_factory.mktemp("server") / "data") as server:
        assert server.process is not None
        process = psutil.Process(server.process.pid)
        server.client.get("/v1/limits").raise_for_status()
        busy = process.cpu_times()
        family = [process, *process.children(recursive=True)]
        yield Started(
            server=server,
            busy_s=busy.user + busy.system,
            size_bytes=sum(each.memory_info().rss for each in family),
            libraries=Path(f"/proc/{process.pid}/maps").read_text(),
        )


@pytest.fixture
def server(started: Started) -> LiveServer:
    """Return the server, which an earlier test may have killed."""
    server = started.server
    assert server.process is not None
    if server.process.poll() is not None:
        server.start()
    return server


@pytest.fixture
def scene(server: LiveServer) -> str:
    return server.scene()


def database_of(server: LiveServer) -> contextlib.closing[sqlite3.Connection]:
    return contextlib.closing(sqlite3.connect(server.data / "lambent.sqlite", timeout=10))


def follow(server: LiveServer, jobs: list[str], seen: list[tuple[str, int]], ended: threading.Event) -> None:
    """Follow jobs like a client that reconnects with the last id after every break, until told to end."""
    last = None
    while not ended.is_set():
        with contextlib.suppress(httpx2.HTTPError, OSError, AssertionError):
            for kind, identifier, data in stream(server.url, server.key, jobs, last):
                if kind == "ping":
                    if ended.is_set():
                        break
                    continue
                last = identifier
                if kind == "snapshot":
                    seen.append((data["id"], -data["last_event"]))
                else:
                    seen.append((data["job_id"], data["seq"]))
        time.sleep(0.05)


def test_runs_survive_kills_of_the_server_and_no_event_is_missing_or_doubled(
    server: LiveServer, scene: str, end: Path
):
    """The first job's process had not been recorded when the server was killed."""
    jobs = [server.submit(scene, **ENDLESS, until=end, checkpoint_every=10) for _ in range(4)]
    seen: list[tuple[str, int]] = []
    ended = threading.Event()
    follower = threading.Thread(target=follow, args=(server, jobs, seen, ended))
    follower.start()
    for job in jobs:
        server.wait_step(job, 2)
    supervisor = server.supervisor(jobs[0])
    for _ in range(SERVER_KILLS):
        server.kill()
        with database_of(server) as database:
            database.execute("UPDATE jobs SET handle = NULL WHERE id = ?", (jobs[0],))
            database.commit()
        server.start()
        wait_until(lambda: f'"pid": {supervisor.pid}' in str(handle_of(server, jobs[0])))
    end.touch()
    found = [server.wait(job) for job in jobs]
    with contextlib.suppress(AssertionError):  # Missing events are reported below.
        wait_until(lambda: {(job["id"], job["last_event"]) for job in found} <= set(seen), timeout_s=20)
    ended.set()
    follower.join(timeout=20)
    assert [job["state"] for job in found] == ["succeeded"] * 4
    # Adopted, not run again.
    assert [job["run"] for job in found] == [1] * 4
    for job in found:
        mine = [seq for job_id, seq in seen if job_id == job["id"]]
        first = -next(seq for seq in mine if seq <= 0)
        told = [seq for seq in mine if seq > 0]
        assert told == list(range(first + 1, job["last_event"] + 1))


def handle_of(server: LiveServer, job: str) -> str | None:
    with database_of(server) as database:
        (handle,) = database.execute("SELECT handle FROM jobs WHERE id = ?", (job,)).fetchone()
    return handle


def test_the_server_ends_in_time_with_open_streams_and_leaves_runs_alone(
    server: LiveServer, scene: str, end: Path
):
    job = server.submit(scene, **ENDLESS, until=end)
    server.wait_step(job, 1)
    opened = threading.Semaphore(0)

    def listen(_: int) -> None:
        with contextlib.suppress(httpx2.HTTPError):
            for kind, _, _ in stream(server.url, server.key, [job]):
                if kind == "snapshot":
                    opened.release()

    with ThreadPoolExecutor(50) as pool:
        for each in range(50):
            pool.submit(listen, each)
        for _ in range(50):
            assert opened.acquire(timeout=20)
        assert server.end(signal.SIGTERM) < 10
    assert server.process is not None
    assert server.process.returncode == 0
    assert [process for process in server.run_processes() if job in process.environ()["LAMBENT_RUN"]]
    server.start()
    end.touch()
    assert server.wait(job)["run"] == 1


def test_ctrl_c_ends_runs_after_a_checkpoint_and_the_next_server_goes_on(
    server: LiveServer, scene: str, end: Path
):
    job = server.submit(scene, **ENDLESS, until=end, checkpoint_every=100_000)
    server.wait_step(job, 5)
    assert server.end(signal.SIGINT) < 10
    assert server.run_processes() == []
    assert not (server.data / "server.json").exists()
    end.touch()
    server.start()
    found = server.wait(job)
    assert (found["state"], found["run"]) == ("succeeded", 2)
    log = server.client.get(f"/v1/jobs/{job}/log").text
    assert int(re.findall(r'"first_step": (\d+)', log)[1]) >= 5


def test_duplicate_submits_make_one_job(server: LiveServer, scene: str):

    def submit(_: int) -> str:
        answer = server.client.post(
            "/v1/jobs",
            json={"scene_id": scene, "preset": "tiny", "params": {"num_steps": "1"}},
            headers={"Idempotency-Key": "the same"[:3]},
        )
        assert answer.status_code == 202, answer.text
        return str(answer.json()["id"])

    with ThreadPoolExecutor(20) as pool:
        made = set(pool.map(submit, range(100)))
    assert len(made) == 1
    history = server.client.get(f"/v1/jobs/{made.pop()}/events").json()["items"]
    assert [event["state"] for event in history].count("queued") == 1


def test_a_second_server_on_the_same_folder_is_refused(server: LiveServer):
    with pytest.raises(ServeError, match=r"serve\.data_in_use"), sole_user(server.data):
        pass
    assert server.client.get("/healthz").status_code == 200


def test_the_server_starts_fast_and_stays_small_without_torch(started: Started):
    # 2.3 s on an idle machine; a core that is shared with other tests does less in a second.
    assert started.busy_s < 4
    assert started.size_bytes < 200 * 2**20
    assert "libtorch" not in started.libraries
    assert "numpy" not in started.libraries


def test_streams_of_clients_that_went_away_are_closed(server: LiveServer, scene: str):
    job = server.submit(scene, num_steps=1)
    server.wait(job)
    for _ in range(5):
        assert next(iter(stream(server.url, server.key, [job])))

    def num_open() -> float:
        text = server.client.get("/metrics").text
        return float(re.search(r"^lambent_open_streams (\S+)", text, re.MULTILINE)[1])  # type: ignore[index]

    wait_until(lambda: num_open() == 0, timeout_s=10)


def test_every_accepted_job_is_there_after_kills_in_a_submit_loop(server: LiveServer, scene: str):
    accepted: list[str] = []
    for number in range(SUBMIT_KILLS):
        if number:
            server.start()
        ended = threading.Event()

        def submit(ended: threading.Event = ended) -> None:
            while not ended.is_set():
                with contextlib.suppress(httpx2.HTTPError, AssertionError):
                    accepted.append(server.submit(scene, num_steps=1, step_s=0))

        before = len(accepted)
        threads = [threading.Thread(target=submit) for _ in range(3)]
        for thread in threads:
            thread.start()
        wait_until(lambda before=before: len(accepted) > before + 10)
        server.kill()
        ended.set()
        for thread in threads:
            thread.join()
        with database_of(server) as database:
            assert database.execute("PRAGMA integrity_check").fetchone() == ("ok",)
            known = {row[0] for row in database.execute("SELECT id FROM jobs")}
        assert set(accepted) <= known
