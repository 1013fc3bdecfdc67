"""The migration of a database with history, while servers of the release before go on writing."""

import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from alembic import command
from alembic.config import Config
from lambent_server.api.search import named
from lambent_server.database import engine
from lambent_server.database.engine import Database
from lambent_server.database.schema import jobs, scenes
from lambent_server.database.tenancy import Tenant, across_tenants
from lambent_server.jobs import counts as job_counts
from sqlalchemy import delete, func, insert, update
from support.databases import without_tables

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]
TENANT = Tenant("a")


def migrate(database: Database, revision: str) -> None:
    """Migrate to a revision, up or down."""
    config = Config()
    config.set_main_option("script_location", str(Path(engine.__file__).parent / "migrations"))
    with database.write() as connection:
        config.attributes["connection"] = connection
        (command.downgrade if revision == "0008" else command.upgrade)(config, revision)


def add_jobs(database: Database, first: int, num: int, state: str = "succeeded") -> None:
    """Add jobs as a server of any release does."""
    common: dict[str, Any] = {"kind": "train", "scene_id": "x", "preset": "tiny", "params": {}, "labels": {}}
    common |= {
        "adjustments": {},
        "created_at": 0.0,
        "updated_at": 0.0,
        "state": state,
        "tenant_id": TENANT.id,
    }
    with database.write() as connection:
        connection.execute(
            insert(jobs), [{**common, "id": f"job_{n:06d}"} for n in range(first, first + num)]
        )


def counted(database: Database) -> tuple[dict[str, int], dict[str, int]]:
    """Return the numbers of jobs by state, as they are kept and as they are."""
    with database.read() as connection:
        by_state = across_tenants(jobs, jobs.c.state, func.count()).group_by(jobs.c.state)
        return job_counts.of_all_tenants(connection), dict(iter(connection.execute(by_state)))


@pytest.fixture(params=["sqlite", pytest.param("postgresql", marks=pytest.mark.services)])
def database(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Database]:
    """Return a database of the release before."""
    with without_tables(request.param, tmp_path) as database:
        migrate(database, "0007")
        migrate(database, "+1")
        yield database


def add_scene(database: Database, identifier: str, name: str) -> None:
    values = {"id": identifier, "name": name, "tenant_id": TENANT.id, "state": "ready", "created_at": 0.0}
    with database.write() as connection:
        connection.execute(insert(scenes).values(**values))


def found(database: Database, words: str) -> list[str]:
    with database.read() as connection:
        return sorted(connection.execute(named(connection, TENANT, words)).scalars())


def test_jobs_from_before_are_counted_and_names_from_before_are_found(database: Database):
    add_jobs(database, 0, 30)
    add_jobs(database, 100, 7, "queued")
    add_scene(database, "scene_1", "Ährenblüte")
    for _ in range(2):
        migrate(database, "head")
        assert counted(database) == ({"succeeded": 30, "queued": 7},) * 2
        assert found(database, "HRENBL") == ["scene_1"]
        migrate(database, "0008")


def test_names_are_found_as_they_are_now(database: Database):
    migrate(database, "head")
    add_scene(database, "scene_1", 'A "quoted" cup')
    add_scene(database, "scene_2", "a saucer")
    assert found(database, '"QUOTED" c') == ["scene_1"]
    with database.write() as connection:
        connection.execute(update(scenes).where(scenes.c.id == "scene_1").values(name="A saucer too"))
    assert found(database, "saucer") == ["scene_1", "scene_2"]
    assert found(database, "quoted") == []
    with database.write() as connection:
        connection.execute(delete(scenes).where(scenes.c.id == "scene_2"))
    assert found(database, "saucer") == ["scene_1"]
    # Too short for the index.
    assert found(database, "OO") == ["scene_1"]
    with database.read() as connection:
        assert connection.execute(named(connection, Tenant("b"), "saucer")).all() == []


def test_counts_follow_all_that_happens_to_jobs_and_are_folded(database: Database):
    migrate(database, "head")
    add_jobs(database, 0, 20, "queued")
    with database.write() as connection:
        connection.execute(update(jobs).where(jobs.c.id < "job_000005").values(state="running"))
        connection.execute(update(jobs).values(updated_at=1.0))
        connection.execute(delete(jobs).where(jobs.c.id >= "job_000018"))
    expected = {"queued": 13, "running": 5}
    assert counted(database) == (expected, expected)
    with database.read() as connection:
        assert job_counts.of_tenant(connection, TENANT) == expected
        assert job_counts.of_tenant(connection, Tenant("b")) == {}
    job_counts.fold(database, fold_from=10_000)
    job_counts.fold(database, fold_from=0)
    assert counted(database) == (expected, expected)
    with database.read() as connection:
        num_rows = len(connection.execute(across_tenants(job_counts.job_counts)).all())
    assert num_rows == 2
    with database.engine.connect() as connection, connection.begin() as transaction:
        connection.execute(update(jobs).values(state="failed"))
        transaction.rollback()
    assert counted(database) == (expected, expected)


@pytest.mark.parametrize("database", [pytest.param("postgresql", marks=pytest.mark.services)], indirect=True)
def test_servers_of_the_release_before_write_during_the_migration_and_are_counted(database: Database):
    add_jobs(database, 0, 2000)
    ending = threading.Event()
    failures: list[Exception] = []

    def work(number: int) -> None:
        first = 10_000 * (number + 1)
        while not ending.is_set():
            try:
                add_jobs(database, first, 2, "queued")
                with database.write() as connection:
                    # In another order than that in which the migration names the tables.
                    connection.execute(
                        insert(scenes).values(
                            id=f"s_{first}", name="x", tenant_id="a", state="open", created_at=0.0
                        )
                    )
                    moved = update(jobs).where(jobs.c.id == f"job_{first:06d}")
                    connection.execute(moved.values(state="failed"))
                    connection.execute(delete(jobs).where(jobs.c.id == f"job_{first + 1:06d}"))
            except Exception as error:
                failures.append(error)
                return
            first += 2

    threads = [threading.Thread(target=work, args=(number,)) for number in range(4)]
    for thread in threads:
        thread.start()
    try:
        migrate(database, "head")
        for _ in range(20):
            job_counts.fold(database, fold_from=0)
    finally:
        ending.set()
        for thread in threads:
            thread.join()
    assert failures == []
    kept, actual = counted(database)
    assert kept == actual
    assert actual["failed"] > 4
