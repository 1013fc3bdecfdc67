"""The controller with an executor on other machines: away, without room, or shared by several servers."""

from pathlib import Path

import pytest
from lambent_server.executors import ExecutorAwayError, Handle, Launch
from support.runs import FakeExecutor, Others, staged


def test_a_run_that_cannot_be_placed_goes_back_to_the_queue_and_says_why(tmp_path: Path):
    with staged(tmp_path, place_retry_s=3600.0) as stage:
        job = stage.start()
        stage.executor.not_placed = "no node had room"
        stage.controller.turn()
        assert (stage.job(job)["state"], stage.job(job)["error"]) == ("retry_wait", None)
        told = stage.api.get(f"/v1/jobs/{job}/events").json()["items"][-1]["message"]
        assert told == "not placed: no node had room; back in the queue in 3600 s"
        stage.executor.not_placed = ""
        stage.set(job, retry_at=0.0)
        stage.controller.turn()
        found = stage.row(job)
        assert (found.state, found.run, found.failures, found.losses) == ("running", 2, 0, 0)


def test_a_cancelled_run_that_cannot_be_placed_is_cancelled(tmp_path: Path):
    with staged(tmp_path) as stage:
        job = stage.start()
        stage.api.post(f"/v1/jobs/{job}:cancel")
        stage.executor.not_placed = "no node had room"
        stage.controller.turn()
        assert stage.job(job)["state"] == "cancelled"


def test_an_order_that_the_cluster_does_not_take_is_no_failure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    def refuse(_self: FakeExecutor, _launch: Launch) -> Handle:
        raise ExecutorAwayError("the head does not answer")

    with staged(tmp_path) as stage:
        job = stage.api.job()["id"]
        monkeypatch.setattr(FakeExecutor, "start", refuse)
        stage.controller.turn()
        assert stage.job(job)["state"] == "retry_wait"
        assert stage.row(job).handle is None


def test_while_the_cluster_is_away_a_run_counts_by_what_it_says_itself(tmp_path: Path):
    with staged(tmp_path, lost_after_s=60.0) as stage:
        job = stage.start()
        stage.executor.away = True
        for _ in range(3):
            stage.call("Heartbeat", job)
            stage.controller.turn()
            stage.controller.clocks.lived.seconds += 50.0
            stage.controller.turn()
        assert (stage.job(job)["state"], stage.job(job)["run"]) == ("running", 1)
        stage.controller.clocks.lived.seconds += 50.0
        stage.controller.turn()
        assert stage.job(job)["run"] == 2


@pytest.mark.parametrize("leads", [True, False])
@pytest.mark.parametrize("adopts", [True, False])
def test_a_run_on_shared_nodes_is_taken_over_from_a_server_that_died(
    tmp_path: Path, adopts: bool, leads: bool
):
    """By any server: the leader may have no part in the cluster."""
    with staged(tmp_path, lost_after_s=60.0) as stage:
        job = stage.start()
        stage.controller._members = Others(leads=leads)
        found = stage.row(job)
        stage.set(job, handle={**found.handle, "server": "server_there"})
        stage.executor.adopts = adopts
        stage.controller.turn()
        expected = "server_here" if adopts else "server_there"
        assert stage.row(job).handle == {**found.handle, "server": expected}
        assert stage.job(job)["run"] == 1


@pytest.mark.parametrize("leads", [True, False])
def test_runs_of_no_row_are_ended_and_no_others(tmp_path: Path, leads: bool):
    with staged(tmp_path, local_slots=2) as stage:
        stage.controller._members = others = Others()
        job, other = stage.start(), stage.start()
        stage.end(1)
        assert stage.job(other)["state"] == "retry_wait"
        others.leads = leads
        stage.executor.known = {f"{job}/1", f"{other}/1", f"{job}/2", "job_strange/1"}
        stage.controller.turn()
        assert sorted(stage.executor.forgotten) == sorted([f"{other}/1", f"{job}/2", "job_strange/1"])


def test_the_executor_is_told_which_runs_have_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    asked: list[bool] = []
    monkeypatch.setattr(
        FakeExecutor, "poll", lambda _self, _handle, *, has_reported=False: asked.append(has_reported)
    )
    with staged(tmp_path) as stage:
        job = stage.start()
        stage.controller.turn()
        stage.call("Heartbeat", job)
        stage.controller.turn()
    assert asked == [False, True]
