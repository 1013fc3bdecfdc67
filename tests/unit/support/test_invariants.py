"""The tests of faults rely on this: a service that breaks a promise is noticed."""

import hashlib
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from lambent_server.database.schema import blobs, bundle_files, bundles, events, jobs
from sqlalchemy import Connection, delete, insert, select, update
from support.invariants import broken
from support.runs import Stage, staged

Fault = Callable[[Connection], None]


@pytest.fixture(scope="module")
def stage(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stage]:
    with staged(tmp_path_factory.mktemp("stage")) as stage:
        yield stage


@pytest.fixture(scope="module")
def job(stage: Stage) -> str:
    return stage.start(scene_id=stage.api.scene({"a.png": b"picture"}))


def lose_job(connection: Connection) -> None:
    connection.execute(delete(jobs))


def lose_event(connection: Connection) -> None:
    first = select(events.c.job_id, events.c.seq).order_by(events.c.seq).limit(1)
    job_id, seq = connection.execute(first).one()
    connection.execute(delete(events).where(events.c.job_id == job_id, events.c.seq == seq))


def begin_twice(connection: Connection) -> None:
    for seq in (101, 102):
        row = {"job_id": connection.execute(select(jobs.c.id)).scalars().first(), "seq": seq}
        row |= {"tenant_id": "default", "at": 0.0, "type": "state", "run": 7, "state": "running"}
        connection.execute(insert(events).values(**row, message="", sha256="", name=""))


def add_bundle(connection: Connection) -> None:
    job_id = connection.execute(select(jobs.c.id)).scalars().first()
    row = {"id": "bundle_x", "tenant_id": "default", "job_id": job_id, "scene_id": "x", "created_at": 0.0}
    connection.execute(insert(bundles).values(**row))


def name_missing_bytes(connection: Connection) -> None:
    row = {
        "bundle_id": "bundle_x",
        "path": "a",
        "tenant_id": "default",
        "sha256": "0" * 64,
        "size_bytes": 1.0,
    }
    connection.execute(insert(bundle_files).values(**row, media_type="text/plain"))


def give_to_a_stranger(connection: Connection) -> None:
    connection.execute(update(events).values(tenant_id="stranger"))


def end_without_time(connection: Connection) -> None:
    connection.execute(update(jobs).values(state="cancelled", finished_at=None))


def forget_blob(connection: Connection) -> None:
    connection.execute(delete(blobs))


@pytest.mark.parametrize(
    ("fault", "names"),
    [
        (lose_job, "P1 accepted and lost"),
        (lose_event, "P2 events missing"),
        (begin_twice, "P2 one run begun twice"),
        (add_bundle, "P2 a bundle of a job that did not succeed"),
        (add_bundle, "P5 a bundle without files"),
        (name_missing_bytes, "P5 bundle_files.sha256 without a blob"),
        (give_to_a_stranger, "P6 an event of another tenant"),
        (end_without_time, "P4 ended without a time"),
        (end_without_time, "P4 the history ends with another state"),
        (forget_blob, "bytes without a blob"),
    ],
)
def test_each_broken_promise_is_named(stage: Stage, job: str, fault: Fault, names: str):
    with stage.api.services.database.engine.connect() as connection:

        def found() -> str:
            return "\n".join(broken(connection, stage.api.services.store, [job]))

        assert names not in found()
        fault(connection)
        assert names in found()
        connection.rollback()


def test_bytes_that_are_gone_or_damaged_are_noticed(stage: Stage, job: str):
    services = stage.api.services
    stage.api.scene({"a.png": b"to be damaged", "b.png": b"to be lost"})

    def path(data: bytes) -> Path:
        return services.settings.data / "store" / services.store.key(hashlib.sha256(data).hexdigest())

    with services.database.engine.connect() as connection:
        assert "P5" not in "\n".join(broken(connection, services.store, [job]))
        path(b"to be damaged").write_bytes(b"to be dAmaged")
        path(b"to be lost").unlink()
        found = "\n".join(broken(connection, services.store, [job]))
    assert "P5 a blob that is not whole" in found
    assert "P5 a blob without its bytes" in found


def test_an_unexpected_error_in_a_log_is_noticed_and_an_outage_is_none(stage: Stage, tmp_path: Path):
    log, services = tmp_path / "server.log", stage.api.services
    with services.database.engine.connect() as connection:
        log.write_text('{"event": "request_put_off"}\n')
        assert "P7" not in "\n".join(broken(connection, services.store, [], [log]))
        log.write_text('{"event": "worker_request_failed"}\n')
        assert "P7" in "\n".join(broken(connection, services.store, [], [log]))
