"""Errors that are outages: the same request may succeed later, and no traceback is logged."""

import contextlib
import errno
import os
import sqlite3
import time
from itertools import pairwise
from pathlib import Path

import pytest
from lambent_server.database.engine import Database
from lambent_server.storage import outages
from lambent_server.storage.outages import outage_of
from lambent_server.storage.s3 import StoreUnavailableError
from obstore.exceptions import GenericError
from sqlalchemy import text
from sqlalchemy.exc import SQLAlchemyError
from structlog.testing import capture_logs
from support.api import expect, expect_problem, opened, sha256
from support.databases import without_tables


def refused_by_sqlite(folder: Path) -> Exception:
    path = folder / "x.sqlite"
    with contextlib.closing(sqlite3.connect(path)) as connection:
        connection.execute("CREATE TABLE t (x)")
    with contextlib.closing(Database(f"sqlite:///file:{path}?mode=ro&uri=true")) as database:
        # The file cannot be put into the mode of write-ahead logs.
        return refused(database)


def refused_by_postgresql(folder: Path) -> Exception:
    with without_tables("postgresql", folder) as database, database.engine.connect() as connection:
        connection.execute(text("SET default_transaction_read_only = on"))
        connection.commit()
        with pytest.raises(SQLAlchemyError) as caught:
            connection.execute(text("CREATE TABLE t (x int)"))
        return caught.value


def refused(database: Database) -> Exception:
    with pytest.raises(SQLAlchemyError) as caught, database.write() as connection:
        connection.execute(text("INSERT INTO t VALUES (1)"))
    return caught.value


@pytest.mark.parametrize(
    "refusal", [refused_by_sqlite, pytest.param(refused_by_postgresql, marks=pytest.mark.services)]
)
def test_a_database_that_is_read_only_is_an_outage(refusal, tmp_path: Path):
    problem = outage_of(refusal(tmp_path))
    assert problem is not None
    assert (problem.status, problem.code, problem.retryable) == (503, "database_read_only", True)
    assert int(problem.headers["retry-after"]) > 0


@pytest.mark.parametrize("number", [errno.EROFS, errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EACCES])
def test_a_disk_that_takes_nothing_is_an_outage_of_the_store(number: int):
    for error in (OSError(number, os.strerror(number)), StoreUnavailableError("x")):
        problem = outage_of(error)
        assert problem is not None
        assert (problem.status, problem.code) == (503, "store_unavailable")


def test_a_mistake_is_none(tmp_path: Path):
    assert outage_of(RuntimeError("x")) is None
    assert outage_of(FileNotFoundError(errno.ENOENT, "x")) is None
    with (
        contextlib.closing(Database(f"sqlite:///{tmp_path / 'x'}")) as database,
        database.read() as connection,
        pytest.raises(SQLAlchemyError) as caught,
    ):
        connection.execute(text("SELECT 1 +"))
    # SQLite has one kind of error for both.
    assert outage_of(caught.value) is not None


def test_an_outage_is_logged_in_one_line_and_a_mistake_with_its_place():
    with capture_logs() as logs:
        outages.report("x_failed", StoreUnavailableError("x"))
        outages.report("x_failed", RuntimeError("x"))
    assert [(each["log_level"], "exc_info" in each) for each in logs] == [("warning", False), ("error", True)]


def test_new_work_does_not_repeat_rounds_during_an_outage(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(outages, "TICK_S", 0.3)
    calls = []

    def turn() -> float:
        calls.append(time.monotonic())
        raise StoreUnavailableError("x")

    rounds = outages.Rounds("x", turn)
    with capture_logs():
        rounds.start()
        end = time.monotonic() + 0.8
        while time.monotonic() < end:
            rounds.wake()
            time.sleep(0.01)
        rounds.close()
    assert 2 <= len(calls) <= 3
    assert min(later - earlier for earlier, later in pairwise(calls)) > 0.29


def test_uploads_to_a_store_that_is_read_only_or_full_are_put_off_until_it_is_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    def refuse(*_: object, **__: object) -> None:
        raise GenericError("Generic LocalFileSystem error: Read-only file system (os error 30)")

    data = b"a picture"
    with opened(tmp_path / "data") as api:
        scene = api.scene({"one.png": data}, commit=False)
        other = sha256(b"other")
        plan = [{"path": "two.png", "size": 5, "sha256": other}]
        expect(api.post(f"/v1/scenes/{scene}/files:plan", json=plan), 200)
        url = f"/v1/scenes/{scene}/files/{other}"
        with monkeypatch.context() as patched, capture_logs() as logs:
            patched.setattr("lambent_server.storage.store.obstore.put", refuse)
            answer = api.put(url, content=b"other")
            expect_problem(answer, 503, "store_unavailable")
            assert int(answer.headers["retry-after"]) > 0
            assert api.get(f"/v1/blobs/{sha256(data)}").content == data
        assert not [each for each in logs if "exc_info" in each]
        expect(api.put(url, content=b"other"), 204)


def test_a_scratch_folder_that_is_read_only_is_an_outage_and_a_full_one_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    with opened(tmp_path / "data") as api:
        scene = api.scene({"one.png": b"x"}, commit=False)
        other = sha256(b"other")
        plan = [{"path": "two.png", "size": 5, "sha256": other}]
        expect(api.post(f"/v1/scenes/{scene}/files:plan", json=plan), 200)
        for number, status in ((errno.EROFS, 503), (errno.ENOSPC, 507)):

            def fail(*_: object, number: int = number, **__: object) -> None:
                raise OSError(number, os.strerror(number))

            with monkeypatch.context() as patched:
                patched.setattr("lambent_server.storage.store.BlobStore.put_file", fail)
                answer = api.put(f"/v1/scenes/{scene}/files/{other}", content=b"other")
            assert answer.status_code == status, answer.text
            assert answer.json()["code"] in ("store_unavailable", "disk_full")
