"""The controller's decisions, with an executor that does what the test says."""

import time
from collections.abc import Iterator
from pathlib import Path
from typing import NoReturn

import pytest
from lambent_proto.v1 import worker_pb2
from lambent_server.executors import Handle, Launch
from lambent_server.jobs.outcomes import adjustments_of
from sqlalchemy.exc import OperationalError
from support.runs import Stage, staged


@pytest.fixture
def stage(tmp_path: Path) -> Iterator[Stage]:
    with staged(tmp_path, retry_delay_s=0.0, local_slots=1, max_losses=4) as stage:
        yield stage


def travel(stage: Stage, seconds: float) -> None:
    """Let time pass for the controller."""
    stage.controller.clocks.lived.seconds += seconds


def test_larger_priority_goes_first_and_then_who_came_first(stage: Stage):
    scene = stage.api.scene()
    jobs = [stage.api.job(scene, priority=priority)["id"] for priority in (0, 5, 0, 5)]
    for _ in jobs:
        stage.controller.turn()
        stage.call("Finish", stage.executor.launches[-1].job_id, outcome=worker_pb2.OUTCOME_SUCCEEDED)
        stage.end(0)
    assert [launch.job_id for launch in stage.executor.launches] == [jobs[1], jobs[3], jobs[0], jobs[2]]


def test_slots_are_shared_between_tenants(tmp_path: Path):
    from support.api import STRANGER_KEY, expect, sha256

    with staged(tmp_path, local_slots=2) as stage:
        mine = [stage.api.job()["id"] for _ in range(3)]
        other = stage.api.other(STRANGER_KEY)
        scene = expect(other.post("/v1/scenes", json={"name": "x"}), 201)["id"]
        digest = sha256(b"{}")
        plan = [{"path": "a.json", "size": 2, "sha256": digest}]
        expect(other.post(f"/v1/scenes/{scene}/files:plan", json=plan), 200)
        expect(other.put(f"/v1/scenes/{scene}/files/{digest}", content=b"{}"), 204)
        expect(other.post(f"/v1/scenes/{scene}:commit"), 200)
        theirs = expect(other.post("/v1/jobs", json={"scene_id": scene, "preset": "tiny"}), 202)["id"]
        stage.controller.turn()
        assert [launch.job_id for launch in stage.executor.launches] == [mine[0], theirs]


def test_gpus_are_handed_out_once_and_small_jobs_pass_by(tmp_path: Path):
    with staged(tmp_path, local_slots=3, local_gpus=1) as stage:
        scene = stage.api.scene()
        jobs = [stage.api.job(scene, gpus=gpus)["id"] for gpus in (1, 1, 0)]
        # What one turn hands out is still in use in the next.
        for _ in range(2):
            stage.controller.turn()
        assert [(launch.job_id, launch.gpus) for launch in stage.executor.launches] == [
            (jobs[0], (0,)),
            (jobs[2], ()),
        ]


def test_a_job_gets_as_many_gpus_as_it_asks_for(tmp_path: Path):
    with staged(tmp_path, local_slots=3, local_gpus=4) as stage:
        scene = stage.api.scene()
        jobs = [stage.api.job(scene, gpus=gpus)["id"] for gpus in (3, 2, 1)]
        stage.controller.turn()
        assert [(launch.job_id, launch.gpus) for launch in stage.executor.launches] == [
            (jobs[0], (0, 1, 2)),
            (jobs[2], (3,)),
        ]


def test_gpus_stay_taken_when_the_server_ends_before_it_could_note_the_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    with staged(tmp_path, local_slots=3, local_gpus=1) as stage:
        first, second = (stage.api.job(gpus=1)["id"] for _ in range(2))
        start = stage.executor.start

        def die(launch: Launch) -> NoReturn:
            start(launch)
            raise SystemExit

        monkeypatch.setattr(stage.executor, "start", die)
        with pytest.raises(SystemExit):
            stage.controller.turn()
        monkeypatch.undo()
        stage.controller.turn()
        stage.call("Register", first, pid=1, process_identity="x")
        stage.controller.turn()
        assert stage.job(second)["state"] == "queued"
        # It is the registered process that is looked at.
        stage.end(1)
        assert stage.job(first)["error"]["code"] == "run_crashed"
        assert stage.job(second)["state"] == "running"


def test_a_lost_run_starts_again_at_once_and_is_no_failure(stage: Stage):
    job = stage.start()
    stage.end()
    found = stage.job(job)
    assert (found["state"], found["run"], found["error"]) == ("running", 2, None)


def test_three_losses_without_a_checkpoint_are_poison(stage: Stage):
    job = stage.start()
    for _ in range(3):
        stage.end(-9)
    found = stage.job(job)
    assert (found["state"], found["error"]["code"]) == ("failed", "run_poisoned")


def test_losses_have_a_limit_even_with_checkpoints(stage: Stage):
    job = stage.start()
    for run in range(1, 6):
        digest = stage.put(job, b"state", run)
        manifest = {"stage": "joint", "step": run, "files": [{"path": "joint/a", "sha256": digest}]}
        stage.call("CommitCheckpoint", job, run, manifest=manifest)
        stage.end(-9)
    found = stage.job(job)
    assert (found["state"], found["error"]["code"]) == ("failed", "run_lost")


def test_a_crash_is_a_failure_and_three_are_the_end(stage: Stage):
    job = stage.start()
    for _ in range(2):
        stage.end(1)
        assert stage.job(job)["state"] in ("retry_wait", "running")
        stage.controller.turn()
        stage.controller.turn()
    stage.end(1)
    found = stage.job(job)
    assert (found["state"], found["run"], found["error"]["code"]) == ("failed", 3, "run_crashed")


def test_the_wait_before_the_next_try_doubles(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    with staged(tmp_path, retry_delay_s=100.0) as stage:
        job = stage.start()
        began, passed = time.time(), 0.0
        for wait in (100.0, 200.0):
            stage.end(1)
            for later, state in ((0.9 * wait, "retry_wait"), (1.1 * wait, "running")):
                for module in ("running.controller", "jobs.outcomes", "jobs.rows"):
                    monkeypatch.setattr(f"lambent_server.{module}.now", lambda at=began + passed + later: at)
                stage.controller.turn()
                assert stage.job(job)["state"] == state
            passed += 1.1 * wait


@pytest.mark.parametrize("cause", ["BAD_SCENE", "BAD_CONFIG"])
def test_what_cannot_get_better_is_not_tried_again(stage: Stage, cause: str):
    job = stage.start()
    stage.call("Fail", job, cause=f"FAIL_CAUSE_{cause}", code="scene.bad", message="fix it")
    found = stage.job(job)
    assert (found["state"], found["run"]) == ("failed", 1)
    assert found["error"] == {"code": "scene.bad", "message": "fix it", "cause": cause.lower(), "run": 1}


def fail_in(stage: Stage, job: str, run: int, where: str, cause: str) -> None:
    """Let a run fail in a stage of training, and the next one start if there is to be one."""
    stage.call("Report", job, run, sequence=1, progress={"stage": where, "step": 1, "num_steps": 9})
    stage.call("Fail", job, run, cause=f"FAIL_CAUSE_{cause}", code="x", message="y")
    stage.end(0)
    stage.controller.turn()
    stage.controller.turn()


@pytest.mark.parametrize(
    ("cause", "field"), [("GPU_OUT_OF_MEMORY", "ray_chunk"), ("DIVERGED", "learning_rate")]
)
def test_some_failures_are_tried_once_more_with_something_changed(stage: Stage, cause: str, field: str):
    job = stage.start()
    assert stage.call("Start", job).adjustments == worker_pb2.Adjustments()
    fail_in(stage, job, 1, "joint", cause)
    assert stage.job(job)["run"] == 2
    adjustments = stage.call("Start", job, 2).adjustments
    assert set(adjustments.stages) == {"joint"}
    assert 0.0 < getattr(adjustments.stages["joint"], field) < 1.0
    fail_in(stage, job, 2, "joint", cause)
    assert stage.job(job)["state"] == "failed"


def test_what_a_failure_has_changed_in_one_stage_stays_when_another_stage_fails(stage: Stage):
    job = stage.start()
    fail_in(stage, job, 1, "cache", "GPU_OUT_OF_MEMORY")
    fail_in(stage, job, 2, "joint", "DIVERGED")
    assert stage.call("Start", job, 3).adjustments == worker_pb2.Adjustments(
        stages={
            "cache": worker_pb2.StageAdjustments(ray_chunk=0.5),
            "joint": worker_pb2.StageAdjustments(learning_rate=0.3),
        }
    )


def test_adjustments_of_the_version_before_are_read():
    row = {"adjustments": {"ray_chunk": 0.5, "stage": "cache"}}
    assert adjustments_of(row) == {"cache": {"ray_chunk": 0.5}}
    assert adjustments_of({"adjustments": {}}) == {}


def test_a_program_that_does_not_start_is_a_failure(stage: Stage):
    stage.executor.broken = True
    job = stage.api.job()["id"]
    for _ in range(6):
        stage.controller.turn()
    found = stage.job(job)
    assert (found["state"], found["error"]["code"]) == ("failed", "run_not_started")


def test_a_cancel_asks_once_and_then_kills(stage: Stage):
    job = stage.start()
    stage.api.post(f"/v1/jobs/{job}:cancel")
    stage.controller.turn()
    stage.controller.turn()
    assert stage.executor.stops == [(1, False)]
    assert stage.job(job)["state"] == "cancelling"
    travel(stage, stage.api.services.settings.stop_grace_s + 1)
    stage.controller.turn()
    assert stage.executor.stops == [(1, False), (1, True)]
    # Only when the process is gone.
    assert stage.job(job)["state"] == "cancelling"
    stage.end(-9)
    assert stage.job(job)["state"] == "cancelled"


def test_a_run_without_a_step_for_too_long_is_stopped(stage: Stage):
    job = stage.start()
    stage.call("Start", job)
    stage.controller.turn()
    travel(stage, stage.api.services.settings.stall_after_s + 1)
    stage.controller.turn()
    assert stage.executor.stops == [(1, False)]
    assert stage.call("Heartbeat", job).stop
    stage.end(-15)
    assert stage.job(job)["error"]["code"] == "run_stalled"


def test_a_machine_that_slept_has_not_stalled(stage: Stage, monkeypatch: pytest.MonkeyPatch):
    import time

    stage.call("Start", stage.start())
    stage.controller.turn()
    slept_s = stage.api.services.settings.stall_after_s * 4
    wall, monotonic = time.time, time.monotonic
    monkeypatch.setattr(time, "time", lambda: wall() + slept_s)
    monkeypatch.setattr(time, "monotonic", lambda: monotonic() + slept_s)
    stage.controller.turn()
    assert stage.executor.stops == []


def test_a_process_that_outlives_its_job_is_ended(stage: Stage):
    job = stage.start()
    stage.call("Finish", job, outcome=worker_pb2.OUTCOME_SUCCEEDED)
    stage.controller.turn()
    assert stage.executor.stops == []
    travel(stage, stage.api.services.settings.stop_grace_s + 1)
    stage.controller.turn()
    assert stage.executor.stops == [(1, True)]


def test_a_silent_run_nobody_can_find_is_lost_only_after_the_interval(stage: Stage):
    job = stage.start()
    with stage.api.services.database.write() as connection:
        from lambent_server.database.schema import jobs
        from sqlalchemy import update

        connection.execute(update(jobs).values(handle=None))
    stage.controller.turn()
    assert stage.job(job)["run"] == 1
    travel(stage, stage.api.services.settings.lost_after_s + 1)
    stage.controller.turn()
    assert stage.job(job)["run"] == 2


def test_a_paused_controller_starts_nothing(stage: Stage):
    stage.controller.close(stop_runs=True)
    job = stage.api.job()["id"]
    stage.controller.turn()
    assert stage.job(job)["state"] == "queued"


def test_nobody_moves_a_job_that_somebody_else_has_moved(stage: Stage):
    from lambent_server.jobs.queries import require_job
    from lambent_server.jobs.rows import move
    from support.api import TENANT

    job = stage.api.job()["id"]
    with stage.api.services.database.write() as connection:
        seen = require_job(connection, TENANT, job)
    stage.api.post(f"/v1/jobs/{job}:cancel")
    with stage.api.services.database.write() as connection:
        assert not move(connection, seen, "running", run=1)
    assert stage.job(job)["state"] == "cancelled"
    assert stage.job(job)["last_event"] == 2


def test_a_server_whose_controller_is_stuck_is_not_fit_to_lead(stage: Stage):
    from lambent_server.running.controller import STUCK_S

    members = stage.controller._members
    assert members.is_fit()
    stage.controller.turned_at -= STUCK_S + 10 * stage.api.services.settings.tick_s + 1.0
    assert not members.is_fit()


def test_runs_that_do_not_end_in_time_when_the_server_does_are_killed(tmp_path: Path):
    with staged(tmp_path, stop_runs_s=0.2, max_losses_without_checkpoint=9) as stage:
        job = stage.start()
        stop = stage.executor.stop

        def kill(handle: Handle, *, force: bool) -> None:
            stop(handle, force=force)
            if force:
                stage.executor.gone[handle["pid"]] = -9

        stage.executor.stop = kill
        stage.controller.close(stop_runs=True)
        assert stage.executor.stops == [(1, False), (1, True)]
        # Nobody has to miss it first.
        assert (stage.job(job)["state"], stage.job(job)["run"]) == ("queued", 1)


def test_runs_on_other_machines_go_on_when_the_server_ends(stage: Stage):
    stage.executor.runs_elsewhere = True
    job = stage.start()
    stage.controller.close(stop_runs=True)
    assert (stage.executor.stops, stage.job(job)["state"]) == ([], "running")


def test_what_ended_since_the_last_round_is_told_when_the_server_ends(stage: Stage):
    job = stage.start()
    stage.call("Heartbeat", job)
    stage.executor.gone[1] = 1
    stage.controller.close(stop_runs=False)
    assert stage.job(job)["error"]["code"] == "run_crashed"


def test_a_database_that_is_away_does_not_keep_a_server_from_ending(
    stage: Stage, monkeypatch: pytest.MonkeyPatch
):
    stage.start()

    def away(*_: object, **__: object) -> NoReturn:
        raise OperationalError("SELECT 1", {}, OSError("away"))

    monkeypatch.setattr(stage.controller, "_read", away)
    stage.controller.close(stop_runs=True)
    assert stage.executor.stops == []
