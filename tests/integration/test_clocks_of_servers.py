"""Servers whose clocks are wrong, on both databases: nothing is lost, hidden or left waiting."""

import contextlib
import json
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from lambent_server.cluster.membership import Membership
from lambent_server.core import clock
from lambent_server.core.clock import SteadyTime, time_of_id
from lambent_server.core.settings import Settings
from lambent_server.database.latest_time import begin_time, latest_time
from lambent_server.database.schema import checkpoints, jobs
from lambent_server.database.service_schema import webhook_deliveries
from lambent_server.database.tenancy import across_tenants
from lambent_server.webhooks.claims import claim
from lambent_server.webhooks.places import Places
from sqlalchemy import update
from support.databases import postgresql, without_tables
from support.live_server import LiveServer, wait_until
from support.runs import Stage, staged
from support.set_clock import SetClock

TEN_MINUTES_S = 600.0


@pytest.fixture(params=["sqlite", pytest.param("postgresql", marks=pytest.mark.services)])
def database(request: pytest.FixtureRequest) -> Iterator[dict[str, str]]:
    """Return the setting of each database."""
    with contextlib.ExitStack() as stack:
        yield {} if request.param == "sqlite" else {"database": stack.enter_context(postgresql())}


@pytest.fixture
def stage(database: dict[str, str], tmp_path: Path) -> Iterator[Stage]:
    with staged(tmp_path / "s", local_slots=4, retry_delay_s=10.0, **database) as stage:
        # A controller without a membership that beats leads nothing on PostgreSQL.
        stage.controller._members.beat()
        yield stage
        stage.controller._members.close()


def commit(stage: Stage, job: str, step: int, run: int = 1) -> None:
    digest = stage.put(job, f"step {step}".encode(), run)
    files = [{"path": "cache/state", "sha256": digest, "size_bytes": len(f"step {step}")}]
    stage.call("CommitCheckpoint", job, run, manifest={"stage": "cache", "step": step, "files": files})


def test_a_run_goes_on_from_the_checkpoint_committed_last_whatever_the_ids_say(
    stage: Stage, monkeypatch: pytest.MonkeyPatch
):
    job, numbers = stage.start(), iter(range(100, 0, -1))
    monkeypatch.setattr("lambent_server.workers.reports.new_id", lambda kind: f"{kind}_{next(numbers):03d}")
    for step in range(10, 70, 10):
        commit(stage, job, step)
    assert [each.step for each in stage.call("Start", job).checkpoints] == [50, 60]
    with stage.api.services.database.read() as connection:
        assert len(connection.execute(across_tenants(checkpoints)).all()) == 2


@pytest.mark.parametrize("jump_s", [-TEN_MINUTES_S, -80_000.0, -10 * 86400.0])
def test_a_job_that_waits_is_tried_again_after_its_wait_when_the_clock_was_set_back(
    stage: Stage, monkeypatch: pytest.MonkeyPatch, jump_s: float
):
    job = stage.start()
    stage.end(1)
    assert stage.job(job)["state"] == "retry_wait"
    wall, monotonic = time.time, time.monotonic
    passed_s = 15.0
    monkeypatch.setattr(time, "time", lambda: wall() + jump_s + passed_s)
    monkeypatch.setattr(time, "monotonic", lambda: monotonic() + passed_s)
    clock.follow(time.time())
    stage.controller._members.beat()
    stage.controller.turn()
    assert stage.job(job)["state"] == "running"


@pytest.mark.parametrize(("wait_s", "is_due"), [(-1.0, True), (3600.0, False), (10 * 86400.0, True)])
def test_a_delivery_waits_for_no_longer_than_any_wait_can_be(stage: Stage, wait_s: float, is_due: bool):
    texts = ("id", "tenant_id", "event", "url", "host", "body")
    values: dict[str, Any] = dict.fromkeys(texts, "x")
    values |= {"state": "pending", "created_at": 0.0, "since": 0.0, "next_at": clock.now() + wait_s}
    services = stage.api.services
    with services.database.write() as connection:
        connection.execute(webhook_deliveries.insert().values(**values, num_attempts=0, attempts=[]))
    assert bool(claim(services.database, services.settings, Places(services.settings))) is is_due


def test_what_was_just_sent_is_not_garbage_after_the_clock_was_set_forward(
    stage: Stage, monkeypatch: pytest.MonkeyPatch
):
    from lambent_server.maintenance.housekeeping import garbage_before

    at = clock.now()
    clock.follow(at + TEN_MINUTES_S)
    clock.now()
    assert garbage_before(stage.api.services.settings) < at
    assert clock.now() >= at + TEN_MINUTES_S


def test_a_server_does_not_begin_before_the_newest_row_of_its_database(stage: Stage):
    stage.api.job()
    database = stage.api.services.database
    later = time.time() + 5000.0
    with database.write() as connection:
        connection.execute(update(jobs).values(updated_at=later))
    with database.read() as connection:
        assert latest_time(connection) == pytest.approx(later)
    begin_time(database)
    assert clock.now() == pytest.approx(later, abs=5.0)
    assert time_of_id(stage.api.job()["id"]) == pytest.approx(later, abs=5.0)


@pytest.mark.services
def test_servers_on_postgresql_take_its_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    with without_tables("postgresql", tmp_path) as database:
        database.migrate()
        steady = SteadyTime()
        for name in ("begin", "follow", "now"):
            monkeypatch.setattr(clock, name, getattr(steady, name))
        monkeypatch.setattr("lambent_server.cluster.membership.follow", steady.follow)
        wall = time.time
        monkeypatch.setattr(time, "time", lambda: wall() - TEN_MINUTES_S)
        begin_time(database)
        assert steady.now() == pytest.approx(wall(), abs=5.0)
        steady.follow(1.0)
        members = Membership(database, Settings(data=tmp_path), host="here", endpoints=())
        members.beat()
        members.close()
        assert steady.now() == pytest.approx(wall(), abs=5.0)


@pytest.mark.slow
@pytest.mark.parametrize("jump_s", [-600, 600])
def test_a_run_loses_one_interval_at_most_after_the_clock_of_its_server_was_set(
    database: dict[str, str], tmp_path: Path, jump_s: int
):
    set_clock = SetClock(tmp_path / "clock")
    with LiveServer(tmp_path / "data", environment=set_clock.environment, **database) as server:
        scene = server.scene()
        job = server.submit(scene, num_steps=400, step_s=0.02, checkpoint_every=10)
        server.wait_step(job, 40)
        set_clock.jump(jump_s)
        reached = server.wait_step(job, 120)["progress"]["step"]
        server.supervisor(job).kill()
        wait_until(lambda: server.job(job)["run"] == 2 and server.job(job)["state"] == "running")
        failing = server.submit(scene, num_steps=3, fail_at=2, fail_once=tmp_path / "failed")
        assert server.wait(failing, timeout_s=30.0)["state"] == "succeeded"
        assert server.wait(job)["state"] == "succeeded"
        assert server.client.get("/v1/jobs").json()["items"][0]["id"] == failing
        log = server.client.get(f"/v1/jobs/{job}/log").text
    steps = [json.loads(line)["first_step"] for line in log.splitlines() if '"first_step"' in line]
    assert steps[0] == 0
    assert steps[1] >= reached - 20
