"""Faults of run processes, against a real server with a pipeline that sleeps."""

import os
import random
import signal
import sqlite3
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.live_server import FINAL, LiveServer, wait_until

pytestmark = pytest.mark.slow
KILLS = int(os.environ.get("LAMBENT_CHAOS_KILLS", "4"))


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveServer]:
    with LiveServer(tmp_path_factory.mktemp("faults") / "data") as server:
        yield server


@pytest.fixture(scope="module")
def scene(server: LiveServer) -> str:
    return server.scene()


def test_jobs_whose_run_processes_are_killed_all_succeed_and_take_effect_once(tmp_path: Path):
    ends = tmp_path / "ends"
    choice = random.Random(1)  # noqa: S311
    killed = 0
    # Kills may come faster than first checkpoints; that this is poison otherwise has its own test.
    with LiveServer(tmp_path / "data", max_losses_without_checkpoint=100, max_losses=100) as server:
        scene = server.scene()
        jobs = [server.submit(scene, num_steps=40, step_s=0.04, touch=ends) for _ in range(2 + KILLS // 3)]
        while killed < KILLS:
            alive = server.run_processes()
            if not alive:
                assert any(server.job(job)["state"] not in FINAL for job in jobs), "too few kills"
                continue
            victim = choice.choice(alive)
            time.sleep(choice.uniform(0.1, 0.5))
            if victim.is_running():
                victim.kill()
                killed += 1
        found = [server.wait(job, timeout_s=60) for job in jobs]
        assert [job["state"] for job in found] == ["succeeded"] * len(jobs)
        assert len({job["bundle_id"] for job in found}) == len(jobs)
        for job in jobs:
            states = [event["state"] for event in server.events(job) if event["type"] == "state"]
            assert states.count("succeeded") == 1
        wait_until(lambda: not server.run_processes())


def test_a_killed_run_goes_on_from_its_last_checkpoint(server: LiveServer, scene: str):
    job = server.submit(scene, num_steps=60, step_s=0.04, checkpoint_every=5)
    reached = server.wait_step(job, 12)["progress"]["step"]
    os.killpg(server.supervisor(job).pid, signal.SIGKILL)
    found = server.wait(job)
    assert found["state"] == "succeeded"
    assert found["run"] == 2
    log = server.client.get(f"/v1/jobs/{job}/log").text
    first_steps = [
        int(line.split('"first_step": ')[1].split(",")[0])
        for line in log.splitlines()
        if "first_step" in line
    ]
    assert first_steps[0] == 0
    assert reached - 5 <= first_steps[1]


def test_a_killed_pipeline_counts_as_lost_and_not_as_failed(server: LiveServer, scene: str):
    job = server.submit(scene, num_steps=30, step_s=0.05)
    server.wait_step(job, 6)
    supervisor = server.supervisor(job)
    supervisor.children()[0].kill()
    found = server.wait(job)
    assert found["state"] == "succeeded"
    assert found["error"] is None
    assert any("ended by SIGKILL" in event["message"] for event in server.events(job))


def test_a_run_that_never_reaches_a_checkpoint_is_given_up_after_three_losses(server: LiveServer, scene: str):
    job = server.submit(scene, num_steps=1000, step_s=0.05, checkpoint_every=1000)
    for run in (1, 2, 3):
        wait_until(lambda run=run: server.job(job)["run"] == run and server.job(job)["state"] == "running")
        wait_until(lambda run=run: server.job(job)["progress"] or run > 1)
        supervisor = wait_until(
            lambda run=run: next(
                (p for p in server.run_processes("run") if f'"run": {run}' in p.environ()["LAMBENT_RUN"]),
                None,
            )
        )
        os.killpg(supervisor.pid, signal.SIGKILL)
    found = server.wait(job)
    assert found["state"] == "failed"
    assert found["error"]["code"] == "run_poisoned"


def test_a_pipeline_that_fails_is_tried_three_times(server: LiveServer, scene: str):
    job = server.submit(scene, num_steps=10, fail_at=3, checkpoint_every=100)
    found = server.wait(job)
    assert found["state"] == "failed"
    assert found["run"] == 3
    assert found["error"]["code"] == "run.crashed"
    assert "Traceback" in server.client.get(f"/v1/jobs/{job}/log").text
    assert "Traceback" not in found["error"]["message"]


def test_a_pipeline_that_fails_once_succeeds_in_the_end(server: LiveServer, scene: str, tmp_path: Path):
    jobs = {
        how: server.submit(scene, num_steps=10, fail_at=3, fail_how=how, fail_once=tmp_path / how)
        for how in ("exit", "memory", "worker_error")
    }
    for how, job in jobs.items():
        found = server.wait(job)
        assert (found["state"], found["run"]) == ("succeeded", 2), how


def test_a_stale_run_that_wakes_up_again_is_refused_and_ends(server: LiveServer, scene: str, tmp_path: Path):
    ends = tmp_path / "ends"
    job = server.submit(scene, num_steps=40, step_s=0.05, touch=ends)
    server.wait_step(job, 8)
    stale = server.supervisor(job)
    family = [stale, *stale.children(recursive=True)]
    for process in family:
        process.suspend()
    # The machine is out of reach: the executor finds nothing where the process was.
    with sqlite3.connect(server.data / "lambent.sqlite", timeout=10) as database:
        database.execute(
            """UPDATE jobs SET handle = '{"pid": 999999999, "identity": "gone", "gpus": []}' WHERE id = ?""",
            (job,),
        )
    database.close()
    wait_until(lambda: server.job(job)["run"] == 2)
    for process in family:
        process.resume()
    found = server.wait(job)
    assert (found["state"], found["run"]) == ("succeeded", 2)
    wait_until(lambda: not stale.is_running() or stale.status() == "zombie")
    log = server.client.get(f"/v1/jobs/{job}/log").text
    assert "fenced:" in log.split("== run 2 ==")[0]
    assert ends.read_text() == "run-2\n"


def test_a_stopped_run_that_is_silent_and_cannot_be_found_is_only_judged_after_the_interval(
    server: LiveServer, scene: str
):
    job = server.submit(scene, num_steps=60, step_s=0.05)
    server.wait_step(job, 3)
    supervisor = server.supervisor(job)
    supervisor.suspend()
    time.sleep(1.5)
    # Silent for longer than the limit, but the executor still finds it: it is left alone.
    assert server.job(job)["run"] == 1
    supervisor.resume()
    assert server.wait(job)["run"] == 1


def test_a_hanging_pipeline_is_stopped_and_tried_again(tmp_path: Path):
    with LiveServer(tmp_path / "data", stall_after_s=1.0, max_failures=2, stop_grace_s=0.5) as server:
        job = server.submit(server.scene(), num_steps=10, hang_at=3)
        found = server.wait(job)
        assert found["state"] == "failed"
        assert found["error"]["code"] == "run_stalled"
        assert found["run"] == 2


def test_a_cancel_settles_when_the_process_is_gone(server: LiveServer, scene: str):
    job = server.submit(scene, num_steps=1000, step_s=0.05)
    server.wait_step(job, 2)
    supervisor = server.supervisor(job)
    answer = server.client.post(f"/v1/jobs/{job}:cancel")
    assert answer.status_code == 202
    assert answer.json()["state"] == "cancelling"
    began = time.monotonic()
    server.wait(job, "cancelled")
    assert time.monotonic() - began < server.settings["stop_grace_s"] + 2
    assert not supervisor.is_running() or supervisor.status() == "zombie"


def test_a_cancelled_run_that_ignores_the_signal_is_killed(server: LiveServer, scene: str):
    job = server.submit(scene, num_steps=10, hang_at=3)
    server.wait_step(job, 2)
    server.client.post(f"/v1/jobs/{job}:cancel")
    server.wait(job, "cancelled", timeout_s=server.settings["stop_grace_s"] + 3)
    assert not [p for p in server.run_processes() if job in p.environ().get("LAMBENT_RUN", "")]


def test_final_states_are_final(server: LiveServer, scene: str):
    done = server.submit(scene, num_steps=2)
    server.wait(done, "succeeded")
    answer = server.client.post(f"/v1/jobs/{done}:cancel")
    assert answer.status_code == 409
    assert answer.json()["code"] == "job_final"
    assert server.job(done)["state"] == "succeeded"


def test_a_run_ended_from_outside_writes_a_checkpoint_and_the_job_goes_on(server: LiveServer, scene: str):
    job = server.submit(scene, num_steps=40, step_s=0.05, checkpoint_every=1000)
    server.wait_step(job, 5)
    os.killpg(server.supervisor(job).pid, signal.SIGTERM)
    found = server.wait(job)
    assert (found["state"], found["run"]) == ("succeeded", 2)
    messages = [event["message"] for event in server.events(job)]
    assert any("stopped from outside" in message for message in messages)


def test_nothing_is_left_of_finished_runs_but_their_logs(server: LiveServer, scene: str):
    job = server.submit(scene, num_steps=4)
    server.wait(job)
    folder = server.data / "runs" / job
    wait_until(lambda: sorted(path.name for path in folder.iterdir()) == ["run-1.log"])


def test_checkpoints_of_finished_jobs_leave_the_store(server: LiveServer, scene: str):
    job = server.submit(scene, num_steps=10, checkpoint_every=2)
    assert server.wait(job)["state"] in FINAL

    def count() -> int:
        with sqlite3.connect(server.data / "lambent.sqlite", timeout=10) as database:
            (rows,) = database.execute("SELECT count(*) FROM checkpoint_files").fetchone()
            (garbage,) = database.execute("SELECT count(*) FROM garbage").fetchone()
        database.close()
        return rows + garbage

    wait_until(lambda: count() == 0)
    # What the job has made is still there.
    bundle = server.job(job)["bundle_id"]
    assert server.client.get(f"/v1/bundles/{bundle}/files/models/weights.bin").status_code == 200
