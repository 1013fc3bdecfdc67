"""Work done while an organisation is being closed, or after it is gone, leaves nothing behind."""

import contextlib
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import pytest
from lambent_server.accounts import audit, organisations, users
from lambent_server.accounts.scopes import ALL
from lambent_server.accounts.who import Who, operator
from lambent_server.api.problems import Problem
from lambent_server.core.clock import now
from lambent_server.database.engine import Database
from lambent_server.database.tenancy import Tenant
from support.databases import without_tables

WHO = Who(tenant=Tenant("one"), kind="key", id="key_1", scopes=ALL)


@pytest.fixture(params=["sqlite", pytest.param("postgresql", marks=pytest.mark.services)])
def database(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Database]:
    with without_tables(request.param, tmp_path) as database:
        database.migrate()
        with database.write() as connection:
            organisations.create(connection, WHO.tenant, "one")
        yield database


def test_nothing_is_recorded_of_an_organisation_that_is_closed_or_gone(database: Database):
    with database.write() as connection:
        organisations.update(connection, WHO.tenant, closed_at=now())
    for who, may in (
        (WHO, False),
        (operator(WHO.tenant), True),
        (operator(Tenant("nobody")), False),
        (replace(WHO, tenant=audit.SERVER), True),
    ):
        with contextlib.ExitStack() as stack:
            if not may:
                stack.enter_context(pytest.raises(Problem, match="has just been closed"))
            audit.record(stack.enter_context(database.write()), who, "act")
        with database.read() as connection:
            assert len(list(audit.entries(connection, who.tenant))) == int(may)


def test_what_goes_on_while_an_organisation_is_closed_is_rolled_back(database: Database):
    """Someone got in, an operator closes the organisation, and only then is the request done."""
    begun = threading.Event()

    def late() -> None:
        with database.write() as connection:
            users.create(connection, name="late", email="late@example.com")
            begun.set()
            audit.record(connection, WHO, "act")

    with ThreadPoolExecutor(1) as pool:
        with database.write() as connection:
            organisations.update(connection, WHO.tenant, closed_at=now())
            audit.record(connection, operator(WHO.tenant), "org close")
            request = pool.submit(late)
            # SQLite lets nobody else write meanwhile.
            assert database.is_sqlite or begun.wait(20)
        with pytest.raises(Problem, match="has just been closed"):
            request.result(timeout=30)
    with database.read() as connection:
        assert users.by_email(connection, "late@example.com") is None
