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
from pathlib import Path

import httpx2
import pytest
from support.live_server import LiveServer, stream, wait_until

pytestmark = pytest.mark.slow
SERVER_KILLS = int(os.environ.get("LAMBENT_CHAOS_SERVER_KILLS", "1"))
SUBMIT_KILLS = int(os.environ.get("LAMBENT_CHAOS_SUBMIT_KILLS", "1"))


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveServer]:
    with LiveServer(tmp_path_factory.mktemp("server") / "data") as server:
        yield server


def follow(server: LiveServer, jobs: list[str], seen: list[tuple[str, int]], ended: threading.Event) -> None:
    """Follow jobs as a patient client does: after every break with the last id, until told to end."""
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


def test_runs_survive_kills_of_the_server_and_no_event_is_missing_or_doubled(server: LiveServer):
    scene = server.scene()
    jobs = [server.submit(scene, num_steps=40, step_s=0.06, checkpoint_every=10) for _ in range(4)]
    seen: list[tuple[str, int]] = []
    ended = threading.Event()
    follower = threading.Thread(target=follow, args=(server, jobs, seen, ended))
    follower.start()
    for job in jobs:
        server.wait_step(job, 2)
    for _ in range(SERVER_KILLS):
        server.kill()
        time.sleep(0.5)
        server.start()
        time.sleep(0.5)
    found = [server.wait(job) for job in jobs]
    time.sleep(1.0)
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


def test_the_server_ends_in_time_with_open_streams_and_leaves_runs_alone(server: LiveServer):
    scene = server.scene()
    job = server.submit(scene, num_steps=70, step_s=0.05)
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
    assert server.wait(job)["run"] == 1


def test_ctrl_c_ends_runs_after_a_checkpoint_and_the_next_server_goes_on(server: LiveServer):
    job = server.submit(server.scene(), num_steps=60, step_s=0.05, checkpoint_every=1000)
    server.wait_step(job, 5)
    assert server.end(signal.SIGINT) < 10
    assert server.run_processes() == []
    assert not (server.data / "server.json").exists()
    server.start()
    found = server.wait(job)
    assert (found["state"], found["run"]) == ("succeeded", 2)
    log = server.client.get(f"/v1/jobs/{job}/log").text
    assert int(re.findall(r'"first_step": (\d+)', log)[1]) >= 5


def test_every_accepted_job_is_there_after_kills_in_a_submit_loop(tmp_path: Path):
    with LiveServer(tmp_path / "data", local_slots=1) as server:
        scene = server.scene()
        accepted: list[str] = []
        for _ in range(SUBMIT_KILLS):
            ended = threading.Event()

            def submit(ended: threading.Event = ended) -> None:
                while not ended.is_set():
                    with contextlib.suppress(httpx2.HTTPError, AssertionError):
                        accepted.append(server.submit(scene, num_steps=1, step_s=0))

            threads = [threading.Thread(target=submit) for _ in range(3)]
            for thread in threads:
                thread.start()
            time.sleep(0.7)
            server.kill()
            ended.set()
            for thread in threads:
                thread.join()
            database = sqlite3.connect(server.data / "lambent.sqlite")
            assert database.execute("PRAGMA integrity_check").fetchone() == ("ok",)
            known = {row[0] for row in database.execute("SELECT id FROM jobs")}
            database.close()
            assert set(accepted) <= known
            server.start()
        assert len(accepted) > SUBMIT_KILLS


def test_duplicate_submits_make_one_job(server: LiveServer):
    scene = server.scene()

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


def test_a_server_killed_before_it_noted_the_process_adopts_it_by_its_registration(server: LiveServer):
    job = server.submit(server.scene(), num_steps=30, step_s=0.05)
    server.wait_step(job, 1)
    server.kill()
    database = sqlite3.connect(server.data / "lambent.sqlite")
    database.execute("UPDATE jobs SET handle = NULL")
    database.commit()
    database.close()
    supervisor = server.supervisor(job)
    server.start()

    def noted() -> str:
        database = sqlite3.connect(server.data / "lambent.sqlite", timeout=10)
        (handle,) = database.execute("SELECT handle FROM jobs WHERE id = ?", (job,)).fetchone()
        database.close()
        return str(handle)

    wait_until(lambda: f'"pid": {supervisor.pid}' in noted())
    found = server.wait(job)
    assert (found["state"], found["run"]) == ("succeeded", 1)


def test_a_second_server_on_the_same_folder_is_refused(server: LiveServer):
    other = LiveServer(server.data)
    with pytest.raises(AssertionError, match=r"serve\.data_in_use"):
        other.start()
    assert server.client.get("/healthz").status_code == 200


def test_the_server_starts_fast_and_stays_small_without_torch(server: LiveServer):
    import psutil

    server.end()
    server.start()
    assert server.process is not None
    process = psutil.Process(server.process.pid)
    server.client.get("/v1/limits").raise_for_status()
    # Time of the processor: on a machine with nothing else to do that is the time one waits.
    busy = process.cpu_times()
    time.sleep(0.5)
    family = [process, *process.children(recursive=True)]
    size = sum(each.memory_info().rss for each in family)
    maps = Path(f"/proc/{process.pid}/maps").read_text()
    assert busy.user + busy.system < 3
    assert size < 200 * 2**20
    assert "libtorch" not in maps
    assert "numpy" not in maps


def test_streams_of_clients_that_went_away_are_closed(server: LiveServer):
    job = server.submit(server.scene(), num_steps=1)
    server.wait(job)
    for _ in range(5):
        assert next(iter(stream(server.url, server.key, [job])))

    def num_open() -> float:
        text = server.client.get("/metrics").text
        return float(re.search(r"^lambent_open_streams (\S+)", text, re.MULTILINE)[1])  # type: ignore[index]

    wait_until(lambda: num_open() == 0, timeout_s=10)
