"""Faults of run processes, against a real server with a pipeline that sleeps.

Jobs that must be caught while running continue until a file exists, however slow the machine is.
"""

import contextlib
import os
import random
import signal
import sqlite3
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest
from support.live_server import FINAL, LiveServer, wait_until

pytestmark = pytest.mark.slow
KILLS = int(os.environ.get("LAMBENT_CHAOS_KILLS", "4"))
LOSSES_IN_A_ROW = 3
ENDLESS = {"num_steps": 100_000, "step_s": 0.02}


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveServer]:
    with LiveServer(
        tmp_path_factory.mktemp("faults") / "data",
        stop_grace_s=1.0,
        stage_stall_after_s={"hang": 1.0},
        max_losses_without_checkpoint=LOSSES_IN_A_ROW,
        max_losses=1000,
        run_memory_bytes=2**30,
    ) as server:
        yield server


@pytest.fixture(scope="module")
def scene(server: LiveServer) -> str:
    return server.scene()


def processes_of(server: LiveServer, jobs: list[str]) -> list[tuple[str, psutil.Process]]:
    found = []
    for process in server.run_processes():
        try:
            run = process.environ().get("LAMBENT_RUN", "")
        except psutil.Error:
            continue
        found += [(job, process) for job in jobs if job in run]
    return found


def num_checkpoints(server: LiveServer, job: str) -> int:
    return sum(event["type"] == "checkpoint" for event in server.events(job))


def test_jobs_whose_run_processes_are_killed_all_succeed_and_take_effect_once(
    server: LiveServer, scene: str, tmp_path: Path, end: Path
):
    ends = tmp_path / "ends"
    choice = random.Random(1)  # noqa: S311
    jobs = [server.submit(scene, **ENDLESS, until=end, touch=ends) for _ in range(2 + KILLS // 3)]
    kills, noted = Counter[str](), dict.fromkeys(jobs, 0)
    killed = 0
    while killed < KILLS:
        alive = processes_of(server, jobs)
        if not alive:
            continue
        job, victim = choice.choice(alive)
        time.sleep(choice.uniform(0.0, 0.4))
        kept = num_checkpoints(server, job)
        if kept > noted[job]:
            kills[job], noted[job] = 0, kept
        # More kills before a checkpoint would be poison, which has its own test.
        if victim.is_running() and kills[job] < LOSSES_IN_A_ROW - 1:
            victim.kill()
            killed += 1
            kills[job] += 1
    end.touch()
    found = [server.wait(job) for job in jobs]
    assert [job["state"] for job in found] == ["succeeded"] * len(jobs)
    assert len({job["bundle_id"] for job in found}) == len(jobs)
    for job in jobs:
        states = [event["state"] for event in server.events(job) if event["type"] == "state"]
        assert states.count("succeeded") == 1
    assert sum(job["run"] for job in found) > len(jobs), "no kill was noticed"
    wait_until(lambda: not processes_of(server, jobs))


def test_a_killed_run_goes_on_from_its_last_checkpoint(server: LiveServer, scene: str, end: Path):
    job = server.submit(scene, **ENDLESS, checkpoint_every=5, until=end)
    reached = server.wait_step(job, 12)["progress"]["step"]
    os.killpg(server.supervisor(job).pid, signal.SIGKILL)
    end.touch()
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


def test_a_killed_pipeline_counts_as_lost_and_not_as_failed(server: LiveServer, scene: str, end: Path):
    job = server.submit(scene, **ENDLESS, until=end)
    server.wait_step(job, 6)
    supervisor = server.supervisor(job)
    supervisor.children()[0].kill()
    end.touch()
    found = server.wait(job)
    assert found["state"] == "succeeded"
    assert found["error"] is None
    assert any("ended by SIGKILL" in event["message"] for event in server.events(job))


def test_a_run_that_never_reaches_a_checkpoint_is_given_up_after_three_losses(server: LiveServer, scene: str):
    job = server.submit(scene, **ENDLESS, checkpoint_every=100_000)
    for run in range(1, LOSSES_IN_A_ROW + 1):
        wait_until(lambda run=run: server.job(job)["run"] == run and server.job(job)["state"] == "running")
        wait_until(lambda run=run: server.job(job)["progress"] or run > 1)
        supervisor = wait_until(
            lambda run=run: next(
                (
                    process
                    for _, process in processes_of(server, [job])
                    if process.cmdline()[2:] == ["run"]
                    and f'"run": {run}' in process.environ()["LAMBENT_RUN"]
                ),
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
        how: server.submit(scene, num_steps=3, fail_at=2, fail_how=how, fail_once=tmp_path / how)
        for how in ("exit", "memory", "worker_error")
    }
    for how, job in jobs.items():
        found = server.wait(job)
        assert (found["state"], found["run"]) == ("succeeded", 2), how
    messages = [event["message"] for event in server.events(jobs["memory"])]
    # The machine has more: it is the limit of run processes that ends the allocation.
    assert any(message.startswith("run.out_of_memory") for message in messages)


def test_a_stale_run_that_wakes_up_again_is_refused_and_ends(
    server: LiveServer, scene: str, tmp_path: Path, end: Path
):
    ends = tmp_path / "ends"
    job = server.submit(scene, **ENDLESS, touch=ends, until=end)
    server.wait_step(job, 8)
    stale = server.supervisor(job)
    family = [stale, *stale.children(recursive=True)]
    for process in family:
        process.suspend()
    # The machine is unreachable: the executor does not find the process.
    with sqlite3.connect(server.data / "lambent.sqlite", timeout=10) as database:
        handle = '{"pid": 999999999, "identity": "gone", "run": "x/1", "gpus": []}'
        database.execute("UPDATE jobs SET handle = ? WHERE id = ?", (handle, job))
    database.close()
    wait_until(lambda: server.job(job)["run"] == 2)
    for process in family:
        # Whoever woke up first may have ended the rest.
        with contextlib.suppress(psutil.NoSuchProcess):
            process.resume()
    wait_until(lambda: not stale.is_running() or stale.status() == "zombie")
    end.touch()
    found = server.wait(job)
    assert (found["state"], found["run"]) == ("succeeded", 2)
    log = server.client.get(f"/v1/jobs/{job}/log").text
    assert "fenced:" in log.split("== run 2 ==")[0]
    assert ends.read_text() == "run-2\n"


def test_a_stopped_run_that_is_silent_and_cannot_be_found_is_only_judged_after_the_interval(
    server: LiveServer, scene: str, end: Path
):
    job = server.submit(scene, **ENDLESS, until=end)
    server.wait_step(job, 3)
    supervisor = server.supervisor(job)
    supervisor.suspend()
    time.sleep(server.settings["lost_after_s"] + 0.3)
    # Silent for longer than the limit, but the executor still finds it: it is left alone.
    assert server.job(job)["run"] == 1
    supervisor.resume()
    end.touch()
    assert server.wait(job)["run"] == 1


def test_a_hanging_pipeline_is_stopped_and_tried_again(server: LiveServer, scene: str):
    job = server.submit(scene, num_steps=10, hang_at=3, stage="hang")
    wait_until(lambda: server.job(job)["run"] == 2 or server.job(job)["state"] in FINAL)
    stalls = [event for event in server.events(job) if "run_stalled" in event["message"]]
    assert [event["state"] for event in stalls] == ["retry_wait"]
    server.client.post(f"/v1/jobs/{job}:cancel")
    server.wait(job, "cancelled")


def test_a_cancel_settles_when_the_process_is_gone(server: LiveServer, scene: str):
    job = server.submit(scene, **ENDLESS)
    server.wait_step(job, 2)
    supervisor = server.supervisor(job)
    answer = server.client.post(f"/v1/jobs/{job}:cancel")
    assert answer.status_code == 202
    assert answer.json()["state"] == "cancelling"
    server.wait(job, "cancelled", timeout_s=server.settings["stop_grace_s"] + 10)
    assert not supervisor.is_running() or supervisor.status() == "zombie"


def test_a_cancelled_run_that_ignores_the_signal_is_killed(server: LiveServer, scene: str):
    job = server.submit(scene, num_steps=10, hang_at=3)
    server.wait_step(job, 2)
    server.client.post(f"/v1/jobs/{job}:cancel")
    server.wait(job, "cancelled", timeout_s=server.settings["stop_grace_s"] + 10)
    assert not processes_of(server, [job])


def test_final_states_are_final(server: LiveServer, scene: str):
    done = server.submit(scene, num_steps=2)
    server.wait(done, "succeeded")
    answer = server.client.post(f"/v1/jobs/{done}:cancel")
    assert answer.status_code == 409
    assert answer.json()["code"] == "job_final"
    assert server.job(done)["state"] == "succeeded"


def test_a_run_ended_from_outside_writes_a_checkpoint_and_the_job_goes_on(
    server: LiveServer, scene: str, end: Path
):
    job = server.submit(scene, **ENDLESS, checkpoint_every=100_000, until=end)
    server.wait_step(job, 5)
    os.killpg(server.supervisor(job).pid, signal.SIGTERM)
    wait_until(lambda: num_checkpoints(server, job) == 1)
    end.touch()
    found = server.wait(job)
    assert (found["state"], found["run"]) == ("succeeded", 2)
    messages = [event["message"] for event in server.events(job)]
    assert any("stopped from outside" in message for message in messages)


def test_nothing_is_left_of_finished_runs_but_their_logs_and_what_they_made(server: LiveServer, scene: str):
    job = server.submit(scene, num_steps=4, checkpoint_every=2)
    assert server.wait(job)["state"] in FINAL
    folder = server.data / "runs" / job
    wait_until(lambda: sorted(path.name for path in folder.iterdir()) == ["run-1.log"])

    def count() -> int:
        with sqlite3.connect(server.data / "lambent.sqlite", timeout=10) as database:
            (rows,) = database.execute("SELECT count(*) FROM checkpoint_files").fetchone()
            (garbage,) = database.execute("SELECT count(*) FROM garbage").fetchone()
        database.close()
        return rows + garbage

    wait_until(lambda: count() == 0)
    # The results of the job still exist.
    bundle = server.job(job)["bundle_id"]
    assert server.client.get(f"/v1/bundles/{bundle}/files/models/weights.bin").status_code == 200
