"""Health tells the truth in time, whatever the database and the disk do."""

import contextlib
import errno
import os
import sqlite3
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from anyio import to_thread
from lambent_server.running import health
from support.api import Api, expect, opened


@pytest.fixture
def api(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Api]:
    monkeypatch.setattr(health, "PROBE_S", 0.2)
    with opened(tmp_path / "data") as api:
        yield api


@contextlib.contextmanager
def locked(api: Api) -> Iterator[None]:
    path = api.services.settings.data / "lambent.sqlite"
    with contextlib.closing(sqlite3.connect(path, isolation_level=None)) as connection:
        connection.execute("BEGIN IMMEDIATE")
        yield


def failing(number: int) -> None:
    raise OSError(number, os.strerror(number))


def checks(api: Api, status: int) -> dict[str, str]:
    began = time.monotonic()
    # The client whose requests share the threads: another one would have its own.
    answer = expect(api.get("/readyz"), status)
    assert time.monotonic() - began < 2.0
    return answer["checks"]


def test_a_server_that_works_says_so(api: Api):
    parts = ("controller", "database", "disk", "store", "files")
    told = {"drain": "off", "maintenance": "off"}
    assert checks(api, 200) == {**dict.fromkeys(parts, "ok"), **told}


def test_a_locked_database_is_told_while_every_thread_of_the_requests_waits_for_it(api: Api):
    def have_two_threads() -> None:
        to_thread.current_default_thread_limiter().total_tokens = 2

    api.client.portal.call(have_two_threads)
    with ThreadPoolExecutor(3) as pool:
        with locked(api):
            waiting = [pool.submit(api.post, "/v1/scenes", json={"name": "x"}) for _ in range(3)]
            time.sleep(0.2)
            expect(api.get("/healthz"), 200)
            assert checks(api, 503)["database"] == "locked"
            assert not any(each.done() for each in waiting)
        for each in waiting:
            expect(each.result(), 201)
    assert checks(api, 200)["database"] == "ok"


def test_a_database_that_does_not_answer_is_a_timeout(api: Api, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(type(api.services.database), "probe", lambda *_: time.sleep(1.0) or "ok")
    assert checks(api, 503)["database"] == "timeout"


def test_a_database_that_is_gone_is_told_by_the_kind_of_its_error(api: Api):
    (api.services.settings.data / "lambent.sqlite").rename(api.services.settings.data / "elsewhere")
    assert checks(api, 503)["database"] == "OperationalError"


@pytest.mark.parametrize(
    ("number", "word"), [(errno.ENOSPC, "full"), (errno.EROFS, "read-only"), (errno.EACCES, "unwritable")]
)
def test_a_disk_that_takes_no_bytes_is_told(
    api: Api, monkeypatch: pytest.MonkeyPatch, number: int, word: str
):
    monkeypatch.setattr(os, "fsync", lambda _: failing(number))
    found = checks(api, 503)
    assert (found["disk"], found["store"]) == (word, word)


def test_a_disk_below_the_floor_is_told(tmp_path: Path):
    with opened(tmp_path / "data", disk_floor_bytes=2**62) as api:
        assert checks(api, 503)["disk"] == "low"


def test_a_read_only_database_file_is_told(api: Api, monkeypatch: pytest.MonkeyPatch):
    connect = sqlite3.connect
    monkeypatch.setattr(
        sqlite3, "connect", lambda name, **given: connect(name.replace("mode=rw", "mode=ro"), **given)
    )
    assert checks(api, 503)["database"] == "read-only"


def test_a_store_that_works_is_asked_seldom_and_one_that_does_not_every_time(
    api: Api, monkeypatch: pytest.MonkeyPatch
):
    answers = iter(["unavailable", "ok", "full"])
    monkeypatch.setattr(type(api.services.store), "probe", lambda _: next(answers))
    monkeypatch.setattr(api.app.state.health, "_probes", health.Health(api.services)._probes)
    assert checks(api, 503)["store"] == "unavailable"
    for _ in range(3):
        assert checks(api, 200)["store"] == "ok"
