"""A data folder from before the first release: every command names it and changes nothing in it."""

import contextlib
import hashlib
import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
import typer
from lambent_server.admin.commands import app as admin_app
from lambent_server.cli import keys, serve
from lambent_server.database.engine import Database
from lambent_server.store_command import store
from sqlalchemy import text
from support.databases import without_tables
from typer.testing import CliRunner

pytestmark = pytest.mark.slow
app = typer.Typer()
app.command()(serve)
app.command()(keys)
app.command()(store)
app.add_typer(admin_app, name="admin")
COMMANDS = {
    "serve": ["serve", "--port", "0"],
    "keys": ["keys", "list"],
    "store": ["store", "clean"],
    "admin": ["admin", "jobs", "list"],
    "admin org": ["admin", "org", "close", "default"],
}
FILES = {
    "worker.secret": "secret",
    "server.id": "server_1",
    "api.key": "key",
    "server.lock": "",
    "scratch/upload": "half of a file",
    "store/blobs/ab/ab12": "bytes",
    "runs/job_1/1/log.txt": "a line",
}


def state_of(folder: Path) -> dict[str, tuple[int, str]]:
    """Return time of change and contents of everything in a folder."""
    return {
        str(path.relative_to(folder)): (
            path.stat().st_mtime_ns,
            hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else "",
        )
        for path in (folder, *folder.rglob("*"))
    }


def rows_of(database: Database) -> object:
    with database.read() as connection:
        held = text("SELECT xmin::text, version_num FROM alembic_version")
        names = text("SELECT relname, relfilenode FROM pg_class WHERE relnamespace = 'public'::regnamespace")
        return connection.execute(held).all(), sorted(map(tuple, connection.execute(names)))


@pytest.fixture(params=["merged", "in log", pytest.param("postgresql", marks=pytest.mark.services)])
def kind(request: pytest.FixtureRequest) -> str:
    """Return where the tables are.

    In SQLite as a server leaves it that was killed: "merged" into the file, or still "in log".
    """
    return str(request.param)


@pytest.fixture
def database(kind: str, tmp_path: Path) -> Iterator[Database]:
    with without_tables("postgresql" if kind == "postgresql" else "sqlite", tmp_path) as database:
        yield database


def make_folder(folder: Path, database: Database, kind: str, revision: str) -> list[str]:
    """Make a data folder with tables of a revision, and return the options that name it."""
    for name, content in FILES.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(content)
    with database.write() as connection:
        connection.execute(text("CREATE TABLE alembic_version (version_num TEXT)"))
        connection.execute(text("CREATE TABLE jobs (id TEXT)"))
        connection.execute(text("INSERT INTO alembic_version VALUES (:revision)"), {"revision": revision})
    options = ["--data", str(folder)]
    if not database.is_sqlite:
        return [*options, "--database", database.url.render_as_string(hide_password=False)]
    file = Path(str(database.url.database))
    with database.engine.connect() as connection:
        if kind == "merged":
            connection.exec_driver_sql("PRAGMA wal_checkpoint(TRUNCATE)")
            connection.exec_driver_sql("INSERT INTO jobs VALUES ('only in the log')")
            connection.commit()
        for ending in ("", "-wal"):
            shutil.copy(f"{file}{ending}", folder / f"lambent.sqlite{ending}")
    assert (folder / "lambent.sqlite-wal").stat().st_size > 0
    return options


@pytest.mark.parametrize("command", COMMANDS)
def test_it_is_named_and_nothing_is_changed(database: Database, tmp_path: Path, kind: str, command: str):
    folder = tmp_path / "data"
    options = make_folder(folder, database, kind, "0018")
    before = state_of(folder), None if database.is_sqlite else rows_of(database)
    result = CliRunner().invoke(app, [*COMMANDS[command], *options])
    assert result.exit_code == 2
    (line,) = result.output.splitlines()
    assert line.startswith(f"{COMMANDS[command][0]}.data_unreleased: ")
    assert "before the first release (its tables have revision 0018)" in line
    place = f"data folder {folder} " if database.is_sqlite else f"database {database.url.render_as_string()} "
    assert place in line
    assert line.endswith(f"choose another with {'--data' if database.is_sqlite else '--database'}")
    assert (state_of(folder), None if database.is_sqlite else rows_of(database)) == before


@pytest.mark.parametrize("revision", ["0001", "9999", "f00d1e", "", "r1"])
def test_so_is_every_revision_that_is_not_named_as_those_of_releases(
    database: Database, tmp_path: Path, kind: str, revision: str
):
    folder = tmp_path / "data"
    options = make_folder(folder, database, kind, revision)
    before = state_of(folder)
    result = CliRunner().invoke(app, [*COMMANDS["serve"], *options])
    assert (result.exit_code, result.output.split(":")[0]) == (2, "serve.data_unreleased")
    assert state_of(folder) == before


def test_a_folder_of_this_release_is_used_although_its_tables_are_in_the_log_alone(tmp_path: Path):
    folder = tmp_path / "data"
    folder.mkdir()
    (folder / "worker.secret").write_text("secret")
    url = f"sqlite:///{folder / 'lambent.sqlite'}"
    with contextlib.closing(Database(url)) as database:
        # While it is open, the log is not merged.
        database.migrate()
        result = CliRunner().invoke(app, ["admin", "org", "list", "--json", "--data", str(folder)])
        assert result.exit_code == 0, result.output
        assert json.loads(result.output)["id"] == "default"
