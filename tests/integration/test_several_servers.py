"""Two servers on one PostgreSQL database, each with a data folder of its own, and one store."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx2
import pytest
from sqlalchemy import create_engine, text
from support.databases import postgresql
from support.live_server import FAST, LiveServer, wait_until
from support.pgbouncer import pgbouncer

pytestmark = [pytest.mark.services, pytest.mark.slow, pytest.mark.timeout(300)]

QUICK = {"server_beat_s": 0.2, "server_lost_after_s": 2.0, "log_copy_s": 0.2, "local_slots": 2}
ENDLESS = {"num_steps": 100_000, "step_s": 0.05}


@contextlib.contextmanager
def pair(folder: Path, url: str, **settings: Any) -> Iterator[tuple[LiveServer, LiveServer]]:
    """Yield two servers on a database; the first one was there first."""
    (folder / "store").mkdir(parents=True)
    given = {"database": url, "store": f"file://{folder}/store", **QUICK, **settings}
    with (
        LiveServer(folder / "a", **given) as first,
        LiveServer(folder / "b", key=first.key, **given) as second,
    ):
        yield first, second


@pytest.fixture
def url() -> Iterator[str]:
    with postgresql() as url:
        yield url


@pytest.fixture
def end(tmp_path: Path) -> Iterator[Path]:
    """Yield the file that lets endless jobs end; it is written at the end in any case."""
    path = tmp_path / "end"
    yield path
    path.touch()


def servers(server: LiveServer, url: str) -> dict[str, dict[str, Any]]:
    """Return what `lambent admin servers` lists, by the address of the server."""
    command = [sys.executable, "-m", "lambent", "admin", "servers", "--json"]
    command += ["--data", str(server.data), "--database", url]
    listing = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    return {each["url"]: each for each in map(json.loads, listing.splitlines())}


def leader(url: str, *among: LiveServer) -> LiveServer | None:
    """Return which server leads."""
    engine = create_engine(url.replace("postgresql:", "postgresql+psycopg:"))
    statement = text(
        "SELECT holder FROM leadership WHERE expires_at >= extract(epoch FROM clock_timestamp())"
    )
    with engine.connect() as connection:
        holder = connection.execute(statement).scalar_one_or_none()
    engine.dispose()
    return next((each for each in among if (each.data / "server.id").read_text().strip() == holder), None)


def home(job: dict[str, Any], *among: LiveServer) -> LiveServer:
    """Return the server that has started the run of a job."""
    return next(each for each in among if (each.data / "runs" / job["id"]).exists())


def test_both_servers_start_jobs_of_one_queue_and_none_twice(tmp_path: Path, url: str):
    with pair(tmp_path, url) as (first, second):
        scene = first.scene()
        marks = [tmp_path / f"mark-{number}" for number in range(12)]
        jobs = [
            (first, second)[number % 2].submit(scene, num_steps=6, touch=mark)
            for number, mark in enumerate(marks)
        ]
        found = [second.wait(job) for job in jobs]
        assert [(job["state"], job["run"]) for job in found] == [("succeeded", 1)] * 12
        assert [mark.read_text().count("\n") for mark in marks] == [1] * 12
        assert {home(job, first, second) for job in found} == {first, second}
        listed = servers(second, url)
        assert set(listed) == {first.url, second.url}
        assert sorted(each["leads"] for each in listed.values()) == [False, True]
        second.end()
        assert set(servers(first, url)) == {first.url}


def test_when_the_leader_is_killed_its_runs_report_to_the_other_server_and_go_on(
    tmp_path: Path, url: str, end: Path
):
    with pair(tmp_path, url) as (first, second):
        scene = first.scene()
        jobs = [first.submit(scene, **ENDLESS, until=end, checkpoint_every=10) for _ in range(4)]
        for job in jobs:
            first.wait_step(job, 2)
        leads = leader(url, first, second)
        assert leads is not None
        other = second if leads is first else first
        leads.kill()
        began = time.monotonic()
        wait_until(lambda: leader(url, other) is other, timeout_s=30)
        assert time.monotonic() - began < 15
        before = {job: other.job(job)["progress"]["step"] for job in jobs}
        for job in jobs:
            other.wait_step(job, before[job] + 5)
        # Longer than the time after which silent runs are lost.
        time.sleep(2 * FAST["lost_after_s"])
        assert all(other.job(job)["run"] == 1 for job in jobs)
        orphan = next(job for job in jobs if home(other.job(job), first, second) is leads)
        # The run learns by its heartbeat that it is not wanted any more.
        other.client.post(f"/v1/jobs/{orphan}:cancel").raise_for_status()
        assert other.wait(orphan)["state"] == "cancelled"
        end.touch()
        found = [other.wait(job) for job in jobs if job != orphan]
        assert [(job["state"], job["run"]) for job in found] == [("succeeded", 1)] * 3
        for job in found:
            seqs = [event["seq"] for event in other.events(job["id"])]
            assert seqs == list(range(1, len(seqs) + 1))


def test_a_killed_server_that_comes_back_has_its_runs_again(tmp_path: Path, url: str, end: Path):
    with pair(tmp_path, url) as (first, second):
        job = first.submit(first.scene(), **ENDLESS, until=end)
        first.wait_step(job, 2)
        owner = home(first.job(job), first, second)
        other = second if owner is first else first
        owner.kill()
        wait_until(lambda: leader(url, other) is other, timeout_s=30)
        owner.start()
        step = other.job(job)["progress"]["step"]
        owner.wait_step(job, step + 5)
        owner.client.post(f"/v1/jobs/{job}:cancel").raise_for_status()
        found = other.wait(job)
        assert (found["state"], found["run"]) == ("cancelled", 1)


def test_runs_whose_server_and_processes_are_gone_start_again_on_the_other(
    tmp_path: Path, url: str, end: Path
):
    with pair(tmp_path, url, local_slots=1) as (first, second):
        jobs = [first.submit(first.scene(), **ENDLESS, until=end, checkpoint_every=5) for _ in range(2)]
        for job in jobs:
            first.wait_step(job, 6)
        lost = next(job for job in jobs if home(first.job(job), first, second) is first)
        first.kill()
        for process in first.run_processes():
            with contextlib.suppress(ProcessLookupError):
                os.kill(process.pid, signal.SIGKILL)
        kept = next(job for job in jobs if job != lost)
        second.client.post(f"/v1/jobs/{kept}:cancel").raise_for_status()
        second.wait(kept)
        wait_until(lambda: second.job(lost)["run"] == 2)
        end.touch()
        found = second.wait(lost)
        assert (found["state"], found["run"]) == ("succeeded", 2)
        # From the checkpoint, which is in the store.
        log = second.client.get(f"/v1/jobs/{lost}/log").text
        assert int(log.rpartition('"first_step": ')[2].partition(",")[0].strip("}")) >= 5


def test_links_logins_and_shares_of_one_server_work_on_the_other(tmp_path: Path, url: str):
    with pair(tmp_path, url) as (first, second):
        assert not (second.data / "api.key").exists()
        assert not (second.data / "worker.secret").exists()
        link = first.client.post("/v1/login-links").json()["url"]
        code = {"code": link.partition("#code=")[2]}
        with httpx2.Client(base_url=second.url, verify=False) as browser:
            assert browser.post("/v1/login", json=code).status_code == 204
            assert browser.post("/v1/login", json=code).status_code == 401
            session = browser.cookies["lambent_session"]
        cookie = {"cookie": f"lambent_session={session}"}
        assert httpx2.get(f"{first.url}/v1/jobs", headers=cookie, verify=False).status_code == 200
        job = first.wait(first.submit(first.scene(), num_steps=1))
        share = first.client.post(f"/v1/bundles/{job['bundle_id']}/shares", json={"expires_in_s": 600}).json()
        secret = share["url"].partition("#")[2]
        for server in (first, second):
            answer = httpx2.get(
                f"{server.url}/v1/bundles/{job['bundle_id']}/manifest",
                headers={"authorization": f"Bearer {secret}"},
                verify=False,
            )
            assert answer.status_code == 200, answer.text


def test_jobs_survive_a_database_that_goes_away_while_two_servers_run(tmp_path: Path, url: str, end: Path):
    from support.tcp_proxy import TcpProxy

    proxy = TcpProxy("http://127.0.0.1:5432")
    through = f"{url.partition('@')[0]}@{proxy.url.removeprefix('http://')}/{url.rpartition('/')[2]}"
    try:
        with pair(tmp_path, through) as (first, second):
            scene = first.scene()
            jobs = [first.submit(scene, **ENDLESS, until=end) for _ in range(4)]
            for job in jobs:
                first.wait_step(job, 2)
            proxy.point_at("http://127.0.0.1:1")
            proxy.cut()
            # Longer than a leader lasts without it, and longer than runs may be silent.
            time.sleep(3.0)
            proxy.point_at("http://127.0.0.1:5432")
            wait_until(lambda: leader(url, first, second), timeout_s=30)
            end.touch()
            found = [second.wait(job) for job in jobs]
            assert [(job["state"], job["run"]) for job in found] == [("succeeded", 1)] * 4
    finally:
        proxy.close()


def test_the_log_of_a_run_is_read_through_any_server_also_when_its_own_is_gone(
    tmp_path: Path, url: str, end: Path
):
    with pair(tmp_path, url) as (first, second):
        job = first.submit(first.scene(), **ENDLESS, until=end)
        first.wait_step(job, 2)
        owner = home(first.job(job), first, second)
        other = second if owner is first else first
        line = "== run 1 =="

        def log() -> str:
            return str(other.client.get(f"/v1/jobs/{job}/log").text)

        wait_until(lambda: '"event": "sleep.started"' in log())
        assert line in log()
        end.touch()
        other.wait(job)
        wait_until(lambda: log() == owner.client.get(f"/v1/jobs/{job}/log").text)
        ended = [first.submit(first.scene(), num_steps=1) for _ in range(2)]
        for each in ended:
            first.wait(each)
        for each in ended:
            wait_until(lambda each=each: "sleep.started" in other.client.get(f"/v1/jobs/{each}/log").text)
        time.sleep(1.0)
        wait_until(lambda: log() == owner.client.get(f"/v1/jobs/{job}/log").text)
        whole = owner.client.get(f"/v1/jobs/{job}/log").text
        owner.kill()
        assert log() == whole
        for each in ended:
            assert "sleep.started" in other.client.get(f"/v1/jobs/{each}/log").text
            # Its process may still be there: a busy server may not have seen it end before it was killed.
            wait_until(lambda each=each: other.client.delete(f"/v1/jobs/{each}").is_success)
            assert other.client.get(f"/v1/jobs/{each}/log").status_code == 404


def test_two_servers_work_through_pgbouncer_in_transaction_mode(tmp_path: Path, url: str, end: Path):
    with (
        pgbouncer(url) as pooled,
        pair(tmp_path, pooled, database_direct=url) as (first, second),
    ):
        scene = first.scene()
        short = [(first, second)[number % 2].submit(scene, num_steps=3) for number in range(8)]
        found = [first.wait(job) for job in short]
        assert [(job["state"], job["run"]) for job in found] == [("succeeded", 1)] * 8
        jobs = [first.submit(scene, **ENDLESS, until=end) for _ in range(4)]
        for job in jobs:
            first.wait_step(job, 2)
        leads = leader(url, first, second)
        assert leads is not None
        other = second if leads is first else first
        leads.kill()
        wait_until(lambda: leader(url, other) is other, timeout_s=30)
        end.touch()
        found = [other.wait(job) for job in jobs]
        assert [(job["state"], job["run"]) for job in found] == [("succeeded", 1)] * 4
        for server in (first, second):
            log = (tmp_path / f"{server.data.name}-server-1.log").read_text()
            assert "listening_for_changes" in log
            assert "prepared statement" not in log


def test_jobs_go_on_while_a_newer_server_migrates_and_old_ones_are_restarted(
    tmp_path: Path, url: str, end: Path
):
    with pair(tmp_path, url) as (first, second):
        scene = first.scene()
        jobs = [first.submit(scene, **ENDLESS, until=end) for _ in range(4)]
        for job in jobs:
            first.wait_step(job, 2)
        engine = create_engine(url.replace("postgresql:", "postgresql+psycopg:"))
        with engine.begin() as connection:
            # What a newer version may do beside this one: add, and say whom it serves.
            connection.execute(text("ALTER TABLE jobs ADD COLUMN novelty TEXT"))
            connection.execute(text("CREATE TABLE novelties (id TEXT PRIMARY KEY)"))
            connection.execute(text("UPDATE alembic_version SET version_num = 'r9998'"))
        for server in (first, second):
            server.end()
            server.start()
        assert "schema_newer" in (tmp_path / "a-server-2.log").read_text()
        more = first.submit(scene, num_steps=2)
        end.touch()
        found = [second.wait(job) for job in (*jobs, more)]
        assert [(job["state"], job["run"]) for job in found] == [("succeeded", 1)] * 5
        with engine.begin() as connection:
            # And one that has removed what this version needs.
            connection.execute(text("UPDATE schema_info SET value = 'r9998' WHERE name = 'compatible_from'"))
        engine.dispose()
        first.end()
        with pytest.raises(AssertionError):
            first.start()
        assert "r9998" in (tmp_path / "a-server-3.log").read_text()
        assert second.client.get("/readyz").status_code == 200
