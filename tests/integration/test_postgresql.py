"""The same server on PostgreSQL."""

import contextlib
import os
import signal
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from lambent_server.api.problems import Problem
from lambent_server.core.settings import Settings
from lambent_server.database.engine import Database
from lambent_server.database.tenancy import Tenant
from lambent_server.jobs.queries import check_quota, insert_job
from lambent_server.services import open_services
from sqlalchemy import create_engine, inspect, literal, select, text
from support.databases import ADMIN, postgresql
from support.live_server import LiveServer, wait_until

pytestmark = [pytest.mark.services, pytest.mark.slow]


@pytest.fixture(scope="module")
def url() -> Iterator[str]:
    """Return the URL of an empty database of our own."""
    with postgresql() as url:
        yield url


@pytest.fixture(scope="module")
def server(url: str, tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveServer]:
    with LiveServer(tmp_path_factory.mktemp("pg") / "data", database=url) as server:
        yield server


def test_a_job_runs_is_killed_and_succeeds(server: LiveServer):
    job = server.submit(server.scene(), num_steps=40, step_s=0.04)
    server.wait_step(job, 10)
    os.killpg(server.supervisor(job).pid, signal.SIGKILL)
    found = server.wait(job)
    assert (found["state"], found["run"]) == ("succeeded", 2)
    seqs = [event["seq"] for event in server.events(job)]
    assert seqs == list(range(1, len(seqs) + 1))
    bundle = server.client.get(f"/v1/bundles/{found['bundle_id']}/manifest")
    assert bundle.json()["name"] == "sleep"
    weights = f"/v1/bundles/{found['bundle_id']}/files/models/weights.bin"
    packed = wait_until(
        lambda: (answer := server.client.get(weights)).headers.get("content-encoding") == "gzip" and answer
    )
    assert packed.content == server.client.get(weights, headers={"accept-encoding": "identity"}).content


def test_concurrent_submits_never_pass_the_quota(url: str, tmp_path: Path):
    given = {"data": tmp_path / "data", "database": url, "disk_floor_bytes": 0, "max_queued_jobs": 10}
    services, tenant = open_services(Settings(**given)), Tenant("many_at_once")

    def submit(_: int) -> bool:
        # More GPUs than there are: nobody starts it.
        values = {"kind": "train", "scene_id": "x", "preset": "tiny", "params": {}, "seed": 0, "gpus": 99}
        with contextlib.suppress(Problem), services.database.write() as connection:
            check_quota(connection, tenant, services, 1)
            insert_job(connection, tenant, labels={}, **values)
            return True
        return False

    with contextlib.closing(services.database), ThreadPoolExecutor(30) as pool:
        assert sum(pool.map(submit, range(30))) == 10


def test_duplicate_submits_make_one_job(server: LiveServer):
    scene = server.scene()

    def submit(_: int) -> str:
        body = {"scene_id": scene, "preset": "tiny", "params": {"num_steps": "1"}}
        answer = server.client.post("/v1/jobs", json=body, headers={"Idempotency-Key": "pg"})
        assert answer.status_code == 202, answer.text
        return str(answer.json()["id"])

    with ThreadPoolExecutor(16) as pool:
        assert len(set(pool.map(submit, range(40)))) == 1


def test_runs_outlive_connections_that_the_database_cuts(server: LiveServer, url: str):
    job = server.submit(server.scene(), num_steps=40, step_s=0.04)
    server.wait_step(job, 5)
    admin = create_engine(ADMIN.replace("postgresql:", "postgresql+psycopg:"), isolation_level="AUTOCOMMIT")
    for _ in range(3):
        with admin.connect() as connection:
            statement = text("SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE datname = :name")
            connection.execute(statement, {"name": url.rpartition("/")[2]})
        time.sleep(0.2)
    admin.dispose()
    found = server.wait(job)
    assert (found["state"], found["run"]) == ("succeeded", 1)


@pytest.mark.parametrize(
    ("name", "words", "found"),
    [
        ("Ährenblüte", "äHREN", True),
        ("Ährenblüte", "BLÜTE", True),
        ("Ährenblüte", "ahren", False),
        ("ΟΔΟΣΑ", "οδοσ", True),
        ("ΟΔΟΣΑ", "ΟΔΟΣ", True),
        ("100% Wolle", "% w", True),
        ("100 Wolle", "% w", False),
    ],
)
def test_both_databases_find_words_in_the_same_names(
    url: str, tmp_path: Path, name: str, words: str, found: bool
):
    statement = select(literal(name).icontains(words, autoescape=True))
    for address in (f"{url.replace('postgresql:', 'postgresql+psycopg:')}", f"sqlite:///{tmp_path / 'x'}"):
        with contextlib.closing(Database(address)) as database, database.read() as connection:
            assert bool(connection.execute(statement).scalar_one()) is found, address


def test_the_tables_are_those_of_the_schema(server: LiveServer, url: str):
    from lambent_server.database.schema import metadata

    engine = create_engine(url.replace("postgresql:", "postgresql+psycopg:"))
    found = set(inspect(engine).get_table_names())
    engine.dispose()
    assert found == set(metadata.tables) | {"alembic_version"}


def test_the_migrations_make_exactly_the_schema(tmp_path: Path):
    from alembic.autogenerate import compare_metadata
    from alembic.migration import MigrationContext
    from lambent_server.database.schema import metadata

    with contextlib.closing(Database(f"sqlite:///{tmp_path / 'x.sqlite'}")) as database:
        database.migrate()
        database.migrate()
        # The index of names is SQLite's own.
        given = {"include_name": lambda name, *_: name is None or not name.startswith("scene_n")}
        with database.read() as connection:
            assert compare_metadata(MigrationContext.configure(connection, opts=given), metadata) == []
