"""The upgrade to a next release, with a made-up second migration, on both databases."""

import shutil
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from lambent_server.database import engine
from lambent_server.database.engine import Database
from lambent_server.database.revision import SchemaTooNewError
from lambent_server.database.schema import scenes
from sqlalchemy import func, insert, inspect, select, text, update
from support.databases import without_tables

pytestmark = pytest.mark.slow
SECOND = """
import sqlalchemy as sa
from alembic import op
from lambent_server.database.migration_locks import lock, serve_from

revision = "r0002"
down_revision = "r0001"


def upgrade() -> None:
    lock(("jobs", "scenes"), "ACCESS EXCLUSIVE")
    op.add_column("jobs", sa.Column("weight", sa.Double(), nullable=True))
    op.add_column("scenes", sa.Column("weight", sa.Double(), server_default="7", nullable=False))
    op.create_index("ix_scenes_weight", "scenes", ["weight"])
    serve_from("{serves}")
"""


@pytest.fixture(params=["sqlite", pytest.param("postgresql", marks=pytest.mark.services)])
def database(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Database]:
    with without_tables(request.param, tmp_path) as database:
        yield database


def migrate_to_second(database: Database, folder: Path, serves: str = "r0001") -> None:
    """Start as the next release would, whose tables still serve the servers of the release `serves`."""
    versions = shutil.copytree(engine.MIGRATIONS, folder / "migrations", dirs_exist_ok=True) / "versions"
    (versions / "r0002_weights.py").write_text(SECOND.replace("{serves}", serves))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(engine, "MIGRATIONS", folder / "migrations")
        database.migrate()


def add_scene(database: Database, identifier: str) -> None:
    values = {"id": identifier, "name": "x", "tenant_id": "a", "state": "open", "created_at": 0.0}
    with database.write() as connection:
        connection.execute(insert(scenes).values(size_bytes=0.0, **values))
        connection.execute(text("DELETE FROM jobs"))
        connection.execute(update(scenes).where(scenes.c.id == identifier).values(state="ready"))


def revision(database: Database) -> str:
    with database.read() as connection:
        return str(connection.execute(text("SELECT version_num FROM alembic_version")).scalar_one())


def has_weights(database: Database) -> bool:
    with database.read() as connection:
        return "weight" in {column["name"] for column in inspect(connection).get_columns("scenes")}


def test_rows_are_kept_and_the_migration_runs_once(database: Database, tmp_path: Path):
    database.migrate()
    add_scene(database, "scene_1")
    for _ in range(2):
        migrate_to_second(database, tmp_path)
    with database.read() as connection:
        assert connection.execute(text("SELECT id, weight FROM scenes")).all() == [("scene_1", 7.0)]
    assert revision(database) == "r0002"


def test_a_new_database_is_marked_with_the_newest_revision_and_runs_no_migration(
    database: Database, tmp_path: Path
):
    migrate_to_second(database, tmp_path)
    assert revision(database) == "r0002"
    # They would be columns of the schema.
    assert not has_weights(database)


def test_servers_of_this_release_go_on_if_the_tables_serve_them(database: Database, tmp_path: Path):
    database.migrate()
    migrate_to_second(database, tmp_path)
    database.migrate()
    add_scene(database, "scene_1")
    assert revision(database) == "r0002"


def test_they_refuse_tables_that_do_not(database: Database, tmp_path: Path):
    database.migrate()
    migrate_to_second(database, tmp_path, serves="r0002")
    with pytest.raises(SchemaTooNewError, match="r0002"):
        database.migrate()


@pytest.mark.parametrize("database", [pytest.param("postgresql", marks=pytest.mark.services)], indirect=True)
def test_servers_of_this_release_write_during_the_migration(database: Database, tmp_path: Path):
    database.migrate()
    ending = threading.Event()
    failures: list[Exception] = []
    written = [0] * 4

    def work(number: int) -> None:
        while not ending.is_set():
            try:
                # Locks scenes before jobs, the other way round than the migration.
                add_scene(database, f"scene_{number}_{written[number]}")
            except Exception as error:
                failures.append(error)
                return
            written[number] += 1

    threads = [threading.Thread(target=work, args=(number,)) for number in range(4)]
    for thread in threads:
        thread.start()
    try:
        migrate_to_second(database, tmp_path)
    finally:
        ending.set()
        for thread in threads:
            thread.join()
    assert failures == []
    with database.read() as connection:
        assert connection.execute(select(func.count()).select_from(scenes)).scalar_one() == sum(written)
    assert has_weights(database)
