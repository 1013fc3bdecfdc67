"""Runs of other servers: left alone while those live, and judged by the leader only by what they say."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from lambent_proto.v1 import worker_pb2
from support.runs import Others, Stage, staged


@pytest.fixture
def stage(tmp_path: Path) -> Iterator[Stage]:
    with staged(tmp_path, local_slots=2, lost_after_s=60.0, stall_after_s=900.0) as stage:
        stage.controller._members = Others()
        yield stage


def others(stage: Stage) -> Any:
    return stage.controller._members


def travel(stage: Stage, seconds: float) -> None:
    """Let time pass for the controller, which looks in between."""
    stage.controller.turn()
    stage.controller.clocks.lived.seconds += seconds
    stage.controller.turn()


def give_away(stage: Stage, job: str, **handle: Any) -> None:
    """Make a run one of another server."""
    found = {"pid": 7, "run": "x", "identity": "x", "server": "server_there", "host": "there", "gpus": []}
    stage.set(job, handle={**found, **handle})


def test_a_handle_says_who_has_started_the_run_and_where(stage: Stage):
    job = stage.start()
    found = stage.row(job).handle
    assert {name: found[name] for name in ("executor", "host", "server")} == {
        "executor": "local",
        "host": "here",
        "server": "server_here",
    }
    assert stage.executor.launches[0].servers == ("tls:here:1",)


def test_runs_of_a_server_that_lives_are_none_of_our_business(stage: Stage):
    job = stage.start()
    give_away(stage, job)
    others(stage).alive.add("server_there")
    stage.executor.gone[7] = None
    travel(stage, 1000.0)
    stage.api.post(f"/v1/jobs/{job}:cancel")
    travel(stage, 1000.0)
    assert (stage.job(job)["state"], stage.executor.stops) == ("cancelling", [])


def test_only_the_leader_judges_runs_of_a_dead_server(stage: Stage):
    job = stage.start()
    give_away(stage, job)
    others(stage).leads = False
    travel(stage, 1000.0)
    assert stage.job(job)["state"] == "running"
    others(stage).leads = True
    # It has to wait as long as any run may be silent, from now on.
    travel(stage, 59.0)
    assert stage.job(job)["run"] == 1
    travel(stage, 2.0)
    assert stage.job(job)["run"] == 2
    assert stage.row(job).handle["server"] == "server_here"


def test_a_run_that_reports_is_alive_whoever_is_dead(stage: Stage):
    job = stage.start()
    give_away(stage, job)
    # Its process is not one that can be seen here.
    stage.executor.gone[7] = None
    for _ in range(4):
        travel(stage, 40.0)
        stage.call("Heartbeat", job)
    assert (stage.job(job)["state"], stage.job(job)["run"]) == ("running", 1)
    assert stage.executor.stops == []


def test_a_dead_servers_run_on_this_machine_is_seen(stage: Stage):
    job = stage.start()
    give_away(stage, job, host="here")
    stage.controller.turn()
    assert stage.job(job)["run"] == 1
    stage.executor.gone[7] = None
    others(stage).leads = False
    stage.controller.turn()
    assert stage.job(job)["run"] == 1
    others(stage).leads = True
    stage.controller.turn()
    assert (stage.job(job)["state"], stage.job(job)["run"]) == ("running", 2)


@pytest.mark.parametrize("how", ["Finish", "Fail"])
def test_a_cancelled_run_far_away_is_told_so_and_settled_when_it_says_that_it_ends(stage: Stage, how: str):
    """`Fail` comes from a supervisor that had to kill its pipeline."""
    job = stage.start()
    give_away(stage, job)
    stage.api.post(f"/v1/jobs/{job}:cancel")
    stage.controller.turn()
    assert stage.call("Heartbeat", job).stop
    stage.controller.turn()
    assert stage.job(job)["state"] == "cancelling"
    how_it_ends = {
        "Finish": {"outcome": worker_pb2.OUTCOME_STOPPED},
        "Fail": {"cause": worker_pb2.FAIL_CAUSE_KILLED},
    }
    stage.call(how, job, **how_it_ends[how])
    stage.controller.turn()
    assert stage.job(job)["state"] == "cancelled"
    assert stage.executor.stops == []


def test_a_cancelled_run_of_a_machine_that_vanished_is_settled_within_the_promised_time(stage: Stage):
    job = stage.start()
    give_away(stage, job)
    others(stage).alive.add("server_there")
    stage.controller.turn()
    # The machine vanishes now, and someone cancels; its server counts as alive for another 17 s.
    stage.api.post(f"/v1/jobs/{job}:cancel")
    travel(stage, 17.0)
    assert stage.job(job)["state"] == "cancelling"
    others(stage).alive.clear()
    travel(stage, 12.0)
    # Silent for 29 s: it may live, and have been told to stop.
    assert stage.job(job)["state"] == "cancelling"
    travel(stage, 2.0)
    assert stage.job(job)["state"] == "cancelled"


def test_a_cancelled_run_that_its_server_sees_is_not_taken_at_its_word(stage: Stage):
    job = stage.start()
    stage.api.post(f"/v1/jobs/{job}:cancel")
    stage.controller.turn()
    stage.call("Finish", job, outcome=worker_pb2.OUTCOME_STOPPED)
    travel(stage, 5.0)
    assert stage.job(job)["state"] == "cancelling"
    stage.end(0)
    assert stage.job(job)["state"] == "cancelled"


def test_a_run_far_away_that_does_no_steps_is_told_to_stop(stage: Stage):
    job = stage.start()
    give_away(stage, job)
    for _ in range(17):
        travel(stage, 50.0)
        stage.call("Heartbeat", job)
    assert not stage.call("Heartbeat", job).stop
    travel(stage, 55.0)
    assert stage.call("Heartbeat", job).stop
    assert stage.executor.stops == []


def test_what_others_run_takes_none_of_our_slots_and_gpus(tmp_path: Path):
    with staged(tmp_path, local_slots=1, local_gpus=1) as stage:
        stage.controller._members = Others()
        first = stage.start(gpus=1)
        give_away(stage, first, gpus=[0])
        others(stage).alive.add("server_there")
        second = stage.start(gpus=1)
        assert stage.row(second).handle["gpus"] == [0]


def test_a_server_without_slots_starts_nothing(tmp_path: Path):
    with staged(tmp_path, local_slots=0) as stage:
        job = stage.api.job()["id"]
        stage.controller.turn()
        assert stage.job(job)["state"] == "queued"


def test_a_judgement_that_comes_too_late_has_no_effect(stage: Stage, monkeypatch: pytest.MonkeyPatch):
    job = stage.start()
    give_away(stage, job)
    seen = stage.row(job)
    travel(stage, 61.0)
    assert stage.job(job)["run"] == 2
    from lambent_server.executors import Gone

    assert not stage.controller._settle(seen, Gone(None))
    assert (stage.job(job)["state"], stage.job(job)["run"]) == ("running", 2)
