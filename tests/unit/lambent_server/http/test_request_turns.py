"""Requests of one tenant, however many and however slow, leave threads to those of others."""

import threading
import time
from pathlib import Path

import pytest
from lambent_server.http import request_turns
from lambent_server.scenes import rows as scene_rows
from support.api import STRANGER_KEY, expect, opened


def test_slow_requests_of_one_tenant_leave_half_of_the_threads_to_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    busy, most, lock, free = 0, 0, threading.Lock(), threading.Event()
    plain = scene_rows.create

    def slow(connection, tenant, *given):
        nonlocal busy, most
        if tenant.id == "stranger":
            return plain(connection, tenant, *given)
        with lock:
            busy += 1
            most = max(most, busy)
        free.wait(20)
        with lock:
            busy -= 1
        return plain(connection, tenant, *given)

    monkeypatch.setattr(scene_rows, "create", slow)
    # Otherwise the slow ones would keep SQLite's lock, one after the other.
    monkeypatch.setattr(request_turns, "THREADS", 8)
    with opened(tmp_path / "data", client_share=1.0) as api:
        engine_write = api.services.database.write
        monkeypatch.setattr(type(api.services.database), "write", type(api.services.database).read)
        many = [
            threading.Thread(target=lambda: api.post("/v1/scenes", json={"name": "x"})) for _ in range(30)
        ]
        for each in many:
            each.start()
        time.sleep(1.0)
        began = time.monotonic()
        for _ in range(5):
            expect(api.other(STRANGER_KEY).get("/v1/jobs"), 200)
        took_s = time.monotonic() - began
        seen = most
        free.set()
        for each in many:
            each.join()
        assert engine_write is not None
    assert seen == 4
    assert took_s < 2.0


def test_a_route_that_waits_for_a_job_takes_no_turn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(request_turns, "THREADS", 1)
    with opened(tmp_path / "data") as api:
        job = api.job()["id"]
        waiting = threading.Thread(target=lambda: api.get(f"/v1/jobs/{job}?wait=2"))
        waiting.start()
        time.sleep(0.3)
        began = time.monotonic()
        expect(api.get("/v1/jobs"), 200)
        assert time.monotonic() - began < 1.5
        waiting.join()


def test_a_turn_ends_with_the_response_also_where_that_is_a_problem(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(request_turns, "THREADS", 1)
    with opened(tmp_path / "data") as api:
        for _ in range(3):
            assert api.get("/v1/jobs/none").status_code == 404
            assert api.post("/v1/scenes", json={}).status_code == 422
        expect(api.get("/v1/jobs"), 200)
