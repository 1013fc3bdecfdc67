"""Databases of a test's own on the PostgreSQL server of the tests."""

import contextlib
import os
import secrets
from collections.abc import Iterator
from pathlib import Path

import pytest
from lambent_server.database.engine import Database
from sqlalchemy import create_engine, text
from sqlalchemy.exc import OperationalError

ADMIN = os.environ.get("LAMBENT_TEST_POSTGRES", "postgresql://postgres@127.0.0.1:5432/test")


@contextlib.contextmanager
def postgresql() -> Iterator[str]:
    """Yield the URL of an empty database; skips the test if there is no server."""
    admin = create_engine(ADMIN.replace("postgresql:", "postgresql+psycopg:"), isolation_level="AUTOCOMMIT")
    name = f"lambent_{secrets.token_hex(6)}"
    try:
        with admin.connect() as connection:
            connection.execute(text(f"CREATE DATABASE {name}"))
    except OperationalError as error:
        pytest.skip(f"no PostgreSQL at {ADMIN}: {error}")
    try:
        yield f"{ADMIN.rpartition('/')[0]}/{name}"
    finally:
        with admin.connect() as connection:
            connection.execute(text(f"DROP DATABASE {name} WITH (FORCE)"))
        admin.dispose()


@contextlib.contextmanager
def without_tables(kind: str, folder: Path) -> Iterator[Database]:
    """Yield an empty database of a kind, "sqlite" (a file in `folder`) or "postgresql", before migrations."""
    with contextlib.ExitStack() as stack:
        url = f"sqlite:///{folder / 'x.sqlite'}"
        if kind == "postgresql":
            url = stack.enter_context(postgresql()).replace("postgresql:", "postgresql+psycopg:")
        yield stack.enter_context(contextlib.closing(Database(url)))
