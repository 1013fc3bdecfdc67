"""The tables of a new database on both databases, with what triggers keep: counts, sums and names."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from lambent_server.api.search import named
from lambent_server.database.engine import Database
from lambent_server.database.schema import jobs, metadata, scenes
from lambent_server.database.tenancy import Tenant, across_tenants
from lambent_server.jobs import counts as job_counts
from sqlalchemy import delete, func, insert, inspect, text, update
from sqlalchemy.exc import DBAPIError
from support.databases import without_tables

pytestmark = pytest.mark.slow
TENANT = Tenant("a")


def add_jobs(database: Database, first: int, num: int, state: str = "succeeded") -> None:
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
    with without_tables(request.param, tmp_path) as database:
        yield database


def add_scene(database: Database, identifier: str, name: str) -> None:
    values = {"id": identifier, "name": name, "tenant_id": TENANT.id, "state": "ready", "created_at": 0.0}
    with database.write() as connection:
        connection.execute(insert(scenes).values(size_bytes=0.0, **values))


def found(database: Database, words: str) -> list[str]:
    with database.read() as connection:
        return sorted(connection.execute(named(connection, TENANT, words)).scalars())


def test_the_tables_are_exactly_those_of_the_schema(database: Database):
    database.migrate()
    # The index of names is SQLite's own, and PostgreSQL's is not in the schema.
    given = {"include_name": lambda name, *_: name is None or not name.startswith("scene_n")}
    with database.read() as connection:
        assert compare_metadata(MigrationContext.configure(connection, opts=given), metadata) == []


def test_a_table_of_another_program_is_not_taken_over(database: Database):
    with database.write() as connection:
        connection.execute(text("CREATE TABLE jobs (name TEXT)"))
    with pytest.raises(DBAPIError, match="jobs"):
        database.migrate()
    with database.read() as connection:
        assert inspect(connection).get_table_names() == ["jobs"]


def test_names_are_found_as_they_are_now(database: Database):
    database.migrate()
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
    database.migrate()
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
