"""A database that becomes read-only under a running server, as after a failover, and comes back."""

import contextlib
from collections.abc import Iterator
from pathlib import Path

import psycopg
import pytest
from support.api import Api, expect, expect_problem, opened
from support.databases import ADMIN, postgresql
from support.live_server import LiveServer, wait_until

pytestmark = [pytest.mark.services, pytest.mark.slow]


@pytest.fixture
def url() -> Iterator[str]:
    with postgresql() as url:
        yield url


def set_read_only(url: str, state: str, *, leave: bool = True) -> None:
    """Let new transactions of new sessions be read-only or not, and end the sessions that there are."""
    name = url.rpartition("/")[2]
    with contextlib.closing(psycopg.connect(ADMIN, autocommit=True)) as admin:
        admin.execute(f"ALTER DATABASE {name} SET default_transaction_read_only = {state}")
        if leave:
            admin.execute(
                "SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE datname = %s", (name,)
            )


def writes(api: Api) -> list[object]:
    """Return the answers to some requests that change something."""
    scene = "scene_x"
    return [
        api.post("/v1/scenes", json={"name": "x"}),
        api.post("/v1/jobs", json={"scene_id": scene, "preset": "tiny"}, headers={"Idempotency-Key": "k"}),
        api.post("/v1/keys", json={"name": "x"}),
    ]


def test_changes_are_put_off_and_readiness_says_why_until_it_is_over(url: str, tmp_path: Path):
    with opened(tmp_path / "data", database=url) as api:
        expect(api.post("/v1/scenes", json={"name": "before"}), 201)
        set_read_only(url, "on")
        api.get("/v1/scenes")  # notices that its connection is gone
        for answer in writes(api):
            expect_problem(answer, 503, "database_read_only")
            assert int(answer.headers["retry-after"]) > 0
        assert expect(api.get("/readyz"), 503)["checks"]["database"] == "read-only"
        assert len(expect(api.get("/v1/scenes"), 200)["items"]) == 1
        # The sessions stay: the pool has to leave those that are read-only by itself.
        set_read_only(url, "off", leave=False)
        expect_problem(api.post("/v1/scenes", json={"name": "x"}), 503, "database_read_only")
        expect(api.post("/v1/scenes", json={"name": "after"}), 201)
        assert expect(api.get("/readyz"), 200)["checks"]["database"] == "ok"


def test_jobs_survive_and_no_traceback_is_logged(url: str, tmp_path: Path):
    with LiveServer(tmp_path / "data", database=url, server_beat_s=0.2, server_lost_after_s=2.0) as server:
        scene = server.scene()
        running = server.submit(scene, num_steps=200, step_s=0.02, checkpoint_every=10)
        server.wait_step(running, 5)
        set_read_only(url, "on")
        wait_until(lambda: server.client.get("/readyz").status_code == 503)
        answer = server.client.post("/v1/jobs", json={"scene_id": scene, "preset": "tiny"})
        assert (answer.status_code, answer.json()["code"]) == (503, "database_read_only")
        set_read_only(url, "off")
        wait_until(lambda: server.client.get("/readyz").status_code == 200)
        assert server.wait(server.submit(scene, num_steps=2))["state"] == "succeeded"
        assert server.wait(running)["state"] == "succeeded"
    log = (tmp_path / "data-server-1.log").read_text()
    assert "Traceback" not in log, log
