"""A server beside one of a newer version that has changed the tables."""

import contextlib
from pathlib import Path

import pytest
from lambent_server.database.engine import Database
from lambent_server.database.revision import SchemaTooNewError
from sqlalchemy import text


def changed(database: Database, **values: str) -> None:
    with database.write() as connection:
        connection.execute(text("UPDATE alembic_version SET version_num = 'r9998'"))
        for name, value in values.items():
            statement = text("UPDATE schema_info SET value = :value WHERE name = :name")
            connection.execute(statement, {"name": name, "value": value})


def test_tables_of_a_newer_version_are_used_if_they_serve_this_one(tmp_path: Path):
    with contextlib.closing(Database(f"sqlite:///{tmp_path / 'x'}")) as database:
        database.migrate()
        changed(database)
        database.migrate()
        with database.read() as connection:
            found = connection.execute(text("SELECT version_num FROM alembic_version")).scalar_one()
        assert found == "r9998"


def test_tables_that_do_not_serve_this_version_are_refused(tmp_path: Path):
    with contextlib.closing(Database(f"sqlite:///{tmp_path / 'x'}")) as database:
        database.migrate()
        changed(database, compatible_from="r9998")
        with pytest.raises(SchemaTooNewError, match="r9998"):
            database.migrate()
