"""A deleted organisation leaves no row and no byte, and takes nothing of another one with it."""

import contextlib
import json
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from lambent_server.accounts import audit, keys, organisations, users
from lambent_server.accounts.scopes import ALL
from lambent_server.accounts.who import Who, operator
from lambent_server.admin.commands import app
from lambent_server.api.problems import Problem
from lambent_server.core.clock import now
from lambent_server.core.secrets import new_secret, read_or_create
from lambent_server.core.settings import Settings
from lambent_server.database.model import JobRow
from lambent_server.database.people_schema import members
from lambent_server.database.rows import many
from lambent_server.database.schema import jobs
from lambent_server.database.tenancy import Tenant, add, rows
from lambent_server.jobs.rows import RUNNING, set_fields
from lambent_server.maintenance import erasure, housekeeping
from lambent_server.running import reconciler
from lambent_server.services import Services, open_services
from sqlalchemy import Connection, Double, Integer, LargeBinary, Table, insert, inspect, text
from sqlalchemy.types import JSON, BigInteger
from support.api import expect_problem, opened, sha256
from support.databases import postgresql
from typer.testing import CliRunner

GONE, STAYS = Tenant("gone"), Tenant("stays")
WHO = operator(GONE)
SHARED = b"both have it"


@pytest.fixture(params=["sqlite", pytest.param("postgresql", marks=pytest.mark.services)])
def services(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Services]:
    with contextlib.ExitStack() as stack:
        given: dict[str, Any] = {"data": tmp_path / "data", "disk_floor_bytes": 0, "garbage_after_s": 0.001}
        if request.param == "postgresql":
            given["database"] = stack.enter_context(postgresql())
        services = open_services(Settings(**given))
        read_or_create(tmp_path / "data" / "worker.secret")
        with contextlib.closing(services.database):
            yield services


def value_for(table: Table, column: Any, tenant: Tenant) -> Any:
    """Return a value that fits a column, another one in every tenant."""
    if column.name == "tenant_id":
        return tenant.id
    if column.name == "state":
        return "succeeded"
    if isinstance(column.type, LargeBinary):
        return b"output"
    if isinstance(column.type, JSON):
        return {}
    if isinstance(column.type, (Integer, BigInteger)):
        return 1 if column.primary_key and tenant is GONE else 2
    if isinstance(column.type, Double):
        # A time: nothing of it has expired.
        return now() + 1000.0
    return "{}" if column.name == "details" else f"{table.name} of {tenant.id}"


def fill(services: Services, tenant: Tenant) -> None:
    """Put a row into every table of tenants, whatever its columns are, and blobs into the store."""
    who = Who(tenant=tenant, kind="key", id="key_1", scopes=ALL)
    with services.database.write() as connection:
        organisations.create(connection, tenant, tenant.id)
        user = users.create(connection, name=tenant.id, email=f"{tenant.id}@example.com")
        users.join(connection, tenant, user.id, "viewer")
        for table in erasure.tables_of_tenants():
            made_otherwise = ("organisations", "members", "blobs", "garbage", "usage_sums", "job_counts")
            if table.name in made_otherwise or table.name.startswith("audit_"):
                continue
            values = {
                column.name: value_for(table, column, tenant) for column in table.c if not column.nullable
            }
            connection.execute(insert(table).values(**values))
        audit.record(connection, who, "act")
    for data in (SHARED, tenant.id.encode()):
        path = services.settings.scratch / "x"
        path.write_bytes(data)
        services.store.put_file(services.database.write, tenant, path, sha256(data), "text/plain")


def columns_of_tenants(services: Services) -> list[str]:
    """Return the tables with a tenant, as the database itself knows them."""
    inspector = inspect(services.database.engine)
    return [
        name
        for name in inspector.get_table_names()
        if "tenant_id" in {column["name"] for column in inspector.get_columns(name)}
    ]


def rows_of(services: Services, tenant: Tenant) -> dict[str, int]:
    with services.database.read() as connection:
        found = {}
        for name in columns_of_tenants(services):
            statement = text(f"SELECT count(*) FROM {name} WHERE tenant_id = :tenant")
            found[name] = connection.execute(statement, {"tenant": tenant.id}).scalar_one()
    return {name: count for name, count in found.items() if count}


def stored(services: Services) -> set[str]:
    return {name for digits in range(256) for name in services.store.listed(f"{digits:02x}")}


OPERATOR = Who(tenant=GONE, kind="operator", id="root", scopes=ALL)


def test_nothing_is_left_of_it_and_all_of_the_other(services: Services):
    for tenant in (GONE, STAYS):
        fill(services, tenant)
    # A table that was added, and that this test does not fill, would be a table that deletion forgets.
    all_tables = set(columns_of_tenants(services))
    assert {table.name for table in erasure.tables_of_tenants()} == all_tables
    filled = set(rows_of(services, GONE)) | {"garbage", "audit_permits"}
    assert filled == all_tables
    before = rows_of(services, STAYS)
    assert erasure.close(services, WHO) == 0
    erasure.erase(services, OPERATOR)
    # Only blobs are left for the sweep, with their sum.
    assert set(rows_of(services, GONE)) == {"blobs", "garbage", "usage_sums"}
    housekeeping.sweep(services)
    assert rows_of(services, GONE) == {}
    assert erasure.is_erased(services, GONE)
    assert rows_of(services, STAYS) == before
    assert stored(services) == {sha256(SHARED), sha256(b"stays")}
    found = reconciler.examine(services)
    assert (found.unknown, found.lost, found.unreferenced) == ({}, [], [])
    with services.database.read() as connection:
        assert audit.verify(connection, STAYS).problem == ""
        assert users.by_email(connection, "gone@example.com") is None
        assert users.by_email(connection, "stays@example.com") is not None
        (entry,) = audit.entries(connection, audit.SERVER)
    assert (entry.action, entry.target, entry.actor_id) == ("org delete", "gone", "root")


def test_people_who_belong_to_another_organisation_too_stay(services: Services):
    for tenant in (GONE, STAYS):
        fill(services, tenant)
    with services.database.write() as connection:
        user_id = users.require(connection, "gone@example.com").id
        users.join(connection, STAYS, user_id, "viewer")
    erasure.close(services, WHO)
    erasure.erase(services, OPERATOR)
    with services.database.read() as connection:
        assert users.by_email(connection, "gone@example.com") is not None
        assert connection.execute(rows(GONE, members)).all() == []


def test_it_is_not_deleted_while_it_is_open_or_a_process_runs(services: Services):
    fill(services, GONE)
    with pytest.raises(Problem, match="close gone first"):
        erasure.erase(services, OPERATOR)
    with services.database.write() as connection:
        (job,) = many(connection, rows(GONE, jobs), JobRow)
        set_fields(connection, job, state=RUNNING, handle={"pid": 1, "run": "x/1"})
    assert erasure.close(services, WHO) == 1
    with pytest.raises(Problem, match="have not ended"):
        erasure.erase(services, OPERATOR)
    with services.database.write() as connection:
        set_fields(connection, job, state="cancelled", handle=None)
    assert erasure.close(services, WHO) == 0
    erasure.erase(services, OPERATOR)


def test_the_folders_of_its_jobs_go_too(services: Services):
    fill(services, GONE)
    folder = services.settings.runs / "jobs of gone"
    folder.mkdir()
    (folder / "run-1.log").write_text("x")
    erasure.close(services, WHO)
    erasure.erase(services, OPERATOR)
    assert not folder.exists()


def command(services: Services, *arguments: str) -> Any:
    given = ["--data", str(services.settings.data), "--database", services.settings.database_url]
    return CliRunner().invoke(app, [*arguments, *given], env={"LAMBENT_GARBAGE_AFTER_S": "0.001"})


def test_the_command_shows_first_and_deletes_only_when_told_to(services: Services):
    fill(services, GONE)
    before = rows_of(services, GONE)
    shown = command(services, "org", "delete", "gone")
    assert shown.exit_code == 0
    assert "blobs" in shown.stdout
    assert "nothing was changed" in shown.stderr
    assert rows_of(services, GONE) == before
    done = command(services, "org", "delete", "gone", "--yes")
    assert done.exit_code == 0, done.output
    assert rows_of(services, GONE) == {}
    assert stored(services) == set()
    again = command(services, "org", "delete", "gone", "--yes")
    assert (again.exit_code, "organisation_not_found" in again.stderr) == (4, True)
    assert command(services, "org", "delete", "default", "--yes").exit_code == 2
    assert json.loads(command(services, "audit", "verify", "--org", "-", "--json").stdout)["ok"]


def test_nobody_gets_in_from_the_first_moment(tmp_path: Path):
    with opened(tmp_path / "data") as api:
        with api.services.database.write() as connection:
            organisations.create(connection, GONE, "gone")
            values = {"id": "key_gone", "name": "k", "key_sha256": sha256(b"lk_gone"), "created_at": now()}
            from lambent_server.database.schema import api_keys

            connection.execute(add(GONE, api_keys, **values))
        client = api.other("lk_gone")
        assert client.get("/v1/me").status_code == 200
        erasure.close(api.services, WHO)
        expect_problem(client.get("/v1/me"), 401, "not_authenticated")


def test_closing_is_recorded_once(services: Services):
    fill(services, GONE)
    for _ in range(2):
        assert erasure.close(services, WHO) == 0
    with services.database.read() as connection:
        found = [entry.action for entry in audit.entries(connection, GONE)]
    assert found == ["act", "org close"]


def test_what_an_operator_adds_while_it_goes_is_rolled_back(services: Services):
    """Nothing of a deleted organisation comes back: what asks for no lock first waits when it is recorded."""
    if services.database.is_sqlite:
        # It has one writer at a time.
        return
    fill(services, GONE)
    erasure.close(services, WHO)
    added = threading.Event()

    def add_key() -> None:
        with services.database.write() as connection:
            keys._issue(connection, GONE, "late", new_secret(keys.PREFIX))
            added.set()
            audit.record(connection, OPERATOR, "key create")

    delete_rows = erasure._delete_rows

    def interrupted(connection: Connection, tenant: Tenant) -> None:
        delete_rows(connection, tenant)
        late.append(pool.submit(add_key))
        assert added.wait(20)

    late: list[Any] = []
    with pytest.MonkeyPatch.context() as patched, ThreadPoolExecutor(1) as pool:
        patched.setattr(erasure, "_delete_rows", interrupted)
        erasure.erase(services, OPERATOR)
    (request,) = late
    with pytest.raises(Problem, match="has just been closed"):
        request.result()
    housekeeping.sweep(services)
    assert rows_of(services, GONE) == {}
