"""Drain and maintenance hold for every server on a database, and for nothing else."""

from pathlib import Path

import pytest
from lambent_proto.v1 import worker_pb2
from lambent_server.cluster import server_state
from lambent_server.cluster.server_state import DRAIN, MAINTENANCE, announce, withdraw
from support.api import Api, expect, expect_problem
from support.runs import staged


@pytest.fixture(autouse=True)
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Look at the database every time."""
    monkeypatch.setattr(server_state, "CACHED_S", 0.0)


def tell(api: Api, name: str, **values: object) -> None:
    """Tell the server as an operator does."""
    with api.services.database.write() as connection:
        announce(connection, name, **values)  # type: ignore[arg-type]


def end(api: Api, name: str) -> None:
    """Take it back."""
    with api.services.database.write() as connection:
        withdraw(connection, name)


def test_while_the_server_drains_no_run_starts_and_those_that_run_go_on(tmp_path: Path):
    with staged(tmp_path, local_slots=2) as stage:
        running = stage.start()
        tell(stage.api, DRAIN, message="new disks")
        waiting = stage.api.job()["id"]
        stage.controller.turn()
        assert stage.job(waiting)["state"] == "queued"
        stage.call("Finish", running, outcome=worker_pb2.OUTCOME_SUCCEEDED)
        stage.end(0)
        assert [stage.job(each)["state"] for each in (running, waiting)] == ["succeeded", "queued"]
        assert expect(stage.api.get("/v1/notices"), 200)["drain"]["message"] == "new disks"
        assert "lambent_drain 1.0" in stage.api.get("/metrics").text
        end(stage.api, DRAIN)
        stage.controller.turn()
        assert stage.job(waiting)["state"] == "running"
        assert "lambent_drain 0.0" in stage.api.get("/metrics").text


def test_a_run_that_is_lost_while_the_server_drains_waits(tmp_path: Path):
    with staged(tmp_path) as stage:
        job = stage.start()
        tell(stage.api, DRAIN)
        stage.end()
        stage.controller.turn()
        assert stage.job(job)["state"] == "queued"


def test_maintenance_refuses_changes_and_nothing_else(tmp_path: Path):
    with staged(tmp_path) as stage:
        api = stage.api
        job = stage.start()
        tell(api, MAINTENANCE, message="back at noon", retry_after_s=90)
        for answer in (
            api.post("/v1/scenes", json={"name": "x"}),
            api.patch(f"/v1/jobs/{job}", json={"priority": 1}),
            api.delete(f"/v1/jobs/{job}"),
            api.put(f"/v1/scenes/x/files/{'0' * 64}", content=b"x"),
            api.post(f"/v1/jobs/{job}:cancel"),
        ):
            problem = expect_problem(answer, 503, "maintenance")
            assert (problem["detail"], problem["retryable"]) == ("back at noon", True)
            assert answer.headers["retry-after"] == "90"
        expect(api.get(f"/v1/jobs/{job}"), 200)
        expect(api.post("/v1/estimates", json={"preset": "tiny"}), 200)
        expect_problem(api.other(None).post("/v1/scenes", json={}), 401, "not_authenticated")
        assert expect(api.get("/v1/notices"), 200)["maintenance"]["message"] == "back at noon"
        assert "lambent_maintenance 1.0" in api.get("/metrics").text
        # The run reports, and ends.
        stage.call("Report", job, sequence=1)
        stage.call("Finish", job, outcome=worker_pb2.OUTCOME_SUCCEEDED)
        assert stage.job(job)["state"] == "succeeded"
        ready = expect(api.get("/readyz"), 200)["checks"]
        assert (ready["maintenance"], ready["drain"]) == ("on", "off")
        end(api, MAINTENANCE)
        expect(api.post("/v1/scenes", json={"name": "x"}), 201)


def test_another_server_on_the_database_hears_it_within_a_second(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(server_state, "CACHED_S", 1.0)
    passed = [0.0]
    monkeypatch.setattr(server_state.time, "monotonic", lambda: passed[0])
    with staged(tmp_path) as stage:
        notices = server_state.Notices(stage.api.services.database)
        assert notices.now() == {}
        tell(stage.api, DRAIN)
        assert notices.now() == {}
        passed[0] = 1.0
        assert set(notices.now()) == {DRAIN}


def test_a_message_can_be_changed_and_the_time_stays(tmp_path: Path):
    with staged(tmp_path) as stage:
        tell(stage.api, DRAIN, message="one")
        with stage.api.services.database.read() as connection:
            first = server_state.read(connection)[DRAIN]
        tell(stage.api, DRAIN, message="two")
        with stage.api.services.database.read() as connection:
            second = server_state.read(connection)[DRAIN]
    assert (second.since, second.message) == (first.since, "two")
