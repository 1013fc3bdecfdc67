"""The audit log: every write is in it, and nothing can be taken out of it unnoticed."""

import contextlib
import json
import os
import pwd
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from lambent_server.accounts import audit, organisations
from lambent_server.accounts.scopes import ALL
from lambent_server.accounts.who import Who, operator
from lambent_server.app import describe
from lambent_server.core.clock import now
from lambent_server.database.engine import Database
from lambent_server.database.people_schema import audit_entries, audit_heads
from lambent_server.database.tenancy import Tenant, change, remove, rows
from lambent_server.http.request import SAFE
from sqlalchemy import Connection, text
from sqlalchemy.exc import DBAPIError
from support.api import KEY, TENANT, Api, expect, expect_problem, opened, sha256
from support.databases import without_tables
from support.server_rows import add_bundle

WHO = Who(tenant=Tenant("one"), kind="key", id="key_1", scopes=ALL, address="10.0.0.1", request_id="req_1")
# They change nothing in the database: numbers that are computed, addresses of the store.
WITHOUT_EFFECT = {"estimate_job", "offer_uploads"}


@pytest.fixture(params=["sqlite", pytest.param("postgresql", marks=pytest.mark.services)])
def database(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Database]:
    with without_tables(request.param, tmp_path) as database:
        database.migrate()
        with database.write() as connection:
            organisations.create(connection, WHO.tenant, "one")
        yield database


def filled(database: Database, count: int = 5) -> None:
    for number in range(count):
        with database.write() as connection:
            audit.record(connection, WHO, "act", f"target_{number}", details={"n": number, "ü": None})


def verdict(database: Database) -> audit.Verdict:
    with database.read() as connection:
        return audit.verify(connection, WHO.tenant)


def test_a_log_is_whole_and_numbered(database: Database):
    filled(database)
    found = verdict(database)
    assert (found.num_entries, found.number, found.problem) == (5, 5, "")
    with database.read() as connection:
        entries = list(audit.entries(connection, WHO.tenant))
        assert audit.contains(connection, WHO.tenant, f"3:{entries[2].hash}")
        assert not audit.contains(connection, WHO.tenant, f"3:{entries[1].hash}")
        assert audit.verify(connection, Tenant("other")).problem == ""
    assert [entry.target for entry in entries] == [f"target_{n}" for n in range(5)]
    assert json.loads(entries[4].details) == {"n": 4, "ü": None}


@pytest.mark.parametrize("statement", ["UPDATE audit_entries SET action = 'x'", "DELETE FROM audit_entries"])
def test_the_database_refuses_to_change_or_remove_entries(database: Database, statement: str):
    filled(database)
    with pytest.raises(DBAPIError, match="audit log"), database.write() as connection:
        connection.execute(text(statement))
    assert verdict(database).num_entries == 5


def test_postgresql_refuses_to_empty_the_table(database: Database):
    if database.is_sqlite:
        return
    filled(database, 1)
    with pytest.raises(DBAPIError, match="audit log"), database.write() as connection:
        connection.execute(text("TRUNCATE audit_entries"))


def tamper(database: Database, *statements: Any) -> None:
    """Do what someone can do who owns the database."""
    triggers = ("audit_entries_unchanged", "audit_entries_kept")
    with database.write() as connection:
        for name in triggers:
            on = "" if database.is_sqlite else " ON audit_entries"
            connection.execute(text(f"DROP TRIGGER {name}{on}"))
        for statement in statements:
            connection.execute(statement)


MINE = audit_entries.c


@pytest.mark.parametrize(
    ("statements", "words"),
    [
        ([change(WHO.tenant, audit_entries).where(MINE.number == 3).values(actor_id="key_2")], "changed"),
        ([change(WHO.tenant, audit_entries).where(MINE.number == 3).values(details="{}")], "changed"),
        ([change(WHO.tenant, audit_entries).where(MINE.number == 3).values(at=1.0)], "changed"),
        ([remove(WHO.tenant, audit_entries).where(MINE.number == 3)], "missing"),
        ([remove(WHO.tenant, audit_entries).where(MINE.number == 1)], "missing"),
        ([remove(WHO.tenant, audit_entries).where(MINE.number == 5)], "missing"),
        ([remove(WHO.tenant, audit_entries)], "missing"),
        ([change(WHO.tenant, audit_heads).values(number=4)], "missing"),
    ],
)
def test_tampering_is_noticed(database: Database, statements: list[Any], words: str):
    filled(database)
    tamper(database, *statements)
    assert words in verdict(database).problem


def test_a_log_that_was_written_anew_lacks_what_was_noted(database: Database):
    filled(database)
    noted = verdict(database)
    tamper(database, remove(WHO.tenant, audit_entries), remove(WHO.tenant, audit_heads))
    filled(database)
    assert verdict(database).problem == ""
    with database.read() as connection:
        assert not audit.contains(connection, WHO.tenant, f"{noted.number}:{noted.hash}")


def test_retention_removes_the_oldest_and_the_rest_is_still_whole(database: Database):
    filled(database, 3)
    with database.read() as connection:
        third = list(audit.entries(connection, WHO.tenant))[2]
    border = now()
    filled(database, 2)
    with database.write() as connection:
        assert audit.num_before(connection, WHO.tenant, border) == 3
        assert audit.remove_before(connection, WHO.tenant, border) == 3
        assert audit.remove_before(connection, WHO.tenant, border) == 0
    found = verdict(database)
    assert (found.num_entries, found.number, found.problem) == (2, 5, "")
    with database.read() as connection:
        assert audit.contains(connection, WHO.tenant, f"3:{third.hash}")
    with pytest.raises(DBAPIError, match="audit log"), database.write() as connection:
        connection.execute(text("DELETE FROM audit_entries"))


def test_what_is_written_meanwhile_is_no_tampering(database: Database, monkeypatch: pytest.MonkeyPatch):
    filled(database)
    entries = audit.entries

    def interrupted(connection: Connection, tenant: Tenant) -> Iterator[Any]:
        filled(database, 2)
        return entries(connection, tenant)

    monkeypatch.setattr(audit, "entries", interrupted)
    with database.snapshot() as connection:
        found = audit.verify(connection, WHO.tenant)
    assert (found.num_entries, found.number, found.problem) == (5, 5, "")
    monkeypatch.undo()
    assert verdict(database).num_entries == 7


def test_entries_are_pruned_once_by_two_at_once(database: Database):
    filled(database, 3)
    border = now()
    filled(database, 3)

    def prune() -> int:
        with database.write() as connection:
            return audit.remove_before(connection, WHO.tenant, border)

    with ThreadPoolExecutor(1) as pool:
        with database.write() as connection:
            assert audit.remove_before(connection, WHO.tenant, border) == 3
            second = pool.submit(prune)
            time.sleep(0.5)
        assert second.result(timeout=30) == 0
    found = verdict(database)
    assert (found.num_entries, found.number, found.problem) == (3, 6, "")


def test_an_operator_is_the_account_and_not_what_variables_say(monkeypatch: pytest.MonkeyPatch):
    for name in ("LOGNAME", "USER", "LNAME", "USERNAME"):
        monkeypatch.setenv(name, "somebody_else")
    assert operator(WHO.tenant).id == pwd.getpwuid(os.getuid()).pw_name != "somebody_else"

    def unknown(_uid: int) -> Any:
        raise KeyError

    monkeypatch.setattr(pwd, "getpwuid", unknown)
    assert operator(WHO.tenant).id == f"uid {os.getuid()}"


def test_concurrent_entries_make_one_chain(database: Database):
    def act(number: int) -> None:
        with database.write() as connection:
            audit.record(connection, WHO, "act", str(number))

    with ThreadPoolExecutor(15) as pool:
        list(pool.map(act, range(60)))
    found = verdict(database)
    assert (found.num_entries, found.number, found.problem) == (60, 60, "")


def test_an_entry_that_is_rolled_back_leaves_no_gap(database: Database):
    filled(database, 1)
    with contextlib.suppress(ZeroDivisionError), database.write() as connection:
        audit.record(connection, WHO, "act")
        raise ZeroDivisionError
    filled(database, 1)
    assert verdict(database).num_entries == 2


@pytest.fixture(scope="module")
def api(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Api]:
    folder = tmp_path_factory.mktemp("audit") / "data"
    with opened(folder) as api:
        yield api


def actions(api: Api, **given: Any) -> list[dict[str, Any]]:
    return expect(api.get("/v1/audit", params=given), 200)["items"]


def do_everything(api: Api) -> None:
    """Call every operation that changes something once, with success."""
    scene = api.scene(commit=False)
    head = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 2\n" + bytes(8)
    expect(api.post(f"/v1/scenes/{scene}:commit"), 200)
    expect(api.patch(f"/v1/scenes/{scene}", json={"name": "n"}), 200)
    zipped = expect(api.post("/v1/scenes", json={"name": "z"}), 201)["id"]
    archive = zip_of({"transforms_train.json": b"{1}"})
    expect(api.put(f"/v1/scenes/{zipped}/archive", content=archive), 200)
    job = api.job(scene)["id"]
    expect(api.patch(f"/v1/jobs/{job}", json={"priority": 3}), 200)
    expect(api.post(f"/v1/jobs/{job}:cancel"), 202)
    again = expect(api.post(f"/v1/jobs/{job}:retry"), 202)["id"]
    expect(api.post(f"/v1/jobs/{again}:cancel"), 202)
    expect(api.delete(f"/v1/jobs/{job}"), 204)
    add_bundle(api, api.services.settings.data, {"manifest.json": b"{}"})
    expect(api.patch("/v1/bundles/bundle_x", json={"labels": {"a": "b"}}), 200)
    link = expect(api.post("/v1/bundles/bundle_x/shares", json={}), 201)
    expect(api.delete(f"/v1/shares/{link['id']}"), 204)
    sky = expect(api.post("/v1/environments", params={"name": "sky"}, content=head), 201)["id"]
    lights = [{"environment_id": sky}]
    render = {"bundle_id": "bundle_x", "environments": lights, "cameras": {"turntable": 1}}
    pictures = expect(api.post("/v1/renders", json=render), 202)["id"]
    order = {
        "assets": [{"bundle_id": "bundle_x"}],
        "environments": lights,
        "cameras": [{"turntable": 1}],
    }
    batch = expect(api.post("/v1/batches", json=order), 202)["id"]
    expect(api.post(f"/v1/batches/{batch}:cancel"), 202)
    expect(api.post(f"/v1/batches/{batch}:retry"), 202)
    expect(api.post(f"/v1/batches/{batch}:cancel"), 202)
    expect(api.post(f"/v1/jobs/{pictures}:cancel"), 202)
    expect(api.delete(f"/v1/environments/{sky}"), 204)
    expect(api.delete("/v1/bundles/bundle_x"), 204)
    expect(api.delete(f"/v1/scenes/{zipped}"), 204)
    hook = expect(api.post("/v1/webhooks", json={"url": "https://example.com/"}), 201)["id"]
    expect(api.patch(f"/v1/webhooks/{hook}", json={"name": "n"}), 200)
    expect(api.post(f"/v1/webhooks/{hook}:rotate"), 200)
    delivery = expect(api.post(f"/v1/webhooks/{hook}:ping"), 202)["id"]
    assert delivery
    expect(api.get("/v1/webhook-secret"), 200)
    expect(api.post("/v1/webhook-secret:rotate"), 200)
    expect(api.delete(f"/v1/webhooks/{hook}"), 204)
    key = expect(api.post("/v1/keys", json={"name": "k"}), 201)["id"]
    fresh = expect(api.post(f"/v1/keys/{key}:rotate"), 201)["id"]
    expect(api.delete(f"/v1/keys/{fresh}"), 204)
    code = expect(api.post("/v1/login-links"), 201)["url"].partition("code=")[2]
    browser = api.other(None)
    expect(browser.post("/v1/login", json={"code": code}), 204)
    expect(browser.post("/v1/logout", headers={"x-lambent-csrf": "1"}), 204)


def zip_of(files: dict[str, bytes]) -> bytes:
    import io
    import zipfile

    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, data in files.items():
            archive.writestr(name, data)
    return buffer.getvalue()


# They need a store in S3, a delivery that failed, a user: their own tests see their entries.
ELSEWHERE = {"complete_uploads", "redeliver", "switch_organisation"}


def test_every_write_is_recorded(api: Api):
    do_everything(api)
    found = actions(api)
    done = {entry["action"] for entry in found if entry["outcome"] == "done"}
    writes = {
        operation["operationId"]
        for operations in describe()["paths"].values()
        for method, operation in operations.items()
        if method.upper() not in SAFE
    }
    assert writes - done - WITHOUT_EFFECT == ELSEWHERE
    # Reading a secret counts too.
    assert "get_webhook_secret" in done
    with api.services.database.read() as connection:
        assert audit.verify(connection, TENANT).problem == ""
    assert [entry["id"] for entry in found] == sorted((entry["id"] for entry in found), reverse=True)


def test_an_entry_says_who_did_what_from_where(api: Api):
    answer = api.post("/v1/scenes", json={"name": "recorded"})
    entry = actions(api, limit=1)[0]
    assert entry["target"] == expect(answer, 201)["id"]
    assert (entry["actor_kind"], entry["actor_id"]) == ("key", "key_test")
    assert (entry["action"], entry["outcome"]) == ("create_scene", "done")
    assert (entry["address"], entry["request_id"]) == ("testclient", answer.headers["x-request-id"])
    assert KEY not in json.dumps(entry)


def test_entries_are_filtered_and_paged(api: Api):
    for _ in range(3):
        api.post("/v1/scenes", json={"name": "s"})
    target = expect(api.post("/v1/scenes", json={"name": "s"}), 201)["id"]
    assert [entry["target"] for entry in actions(api, target=target)] == [target]
    assert {entry["action"] for entry in actions(api, action="create_scene")} == {"create_scene"}
    assert actions(api, actor="key_other") == []
    first = expect(api.get("/v1/audit", params={"limit": 2, "action": "create_scene"}), 200)
    cursor = {"limit": 2, "action": "create_scene", "cursor": first["next_cursor"]}
    second = expect(api.get("/v1/audit", params=cursor), 200)
    assert len({entry["id"] for entry in first["items"] + second["items"]}) == 4
    assert actions(api, until=first["items"][0]["at"], since="2020-01-01T00:00:00Z")
    assert actions(api, until="2020-01-01T00:00:00Z") == []
    expect_problem(api.get("/v1/audit", params={"since": "yesterday"}), 422, "invalid_request")


def test_refusals_are_recorded_with_their_code(api: Api):
    made = expect(api.post("/v1/keys", json={"name": "k", "scopes": ["read"]}), 201)
    reader = api.other(made["key"])
    expect_problem(reader.post("/v1/scenes", json={"name": "s"}), 403, "scope_missing")
    expect_problem(reader.get("/v1/audit"), 403, "scope_missing")
    found = actions(api, actor=made["id"])
    assert [(entry["action"], entry["outcome"]) for entry in found] == [
        ("list_audit_entries", "scope_missing"),
        ("create_scene", "scope_missing"),
    ]
    expect_problem(api.get(f"/v1/scenes/{sha256(b'')[:20]}"), 404, "scene_not_found")
    assert actions(api, limit=1)[0]["outcome"] == "scope_missing"


def test_an_effect_that_fails_leaves_no_entry(api: Api):
    before = actions(api, limit=1)
    expect_problem(api.post("/v1/jobs", json={"scene_id": "none", "preset": "tiny"}), 404, "scene_not_found")
    assert actions(api, limit=1) == before


def test_others_do_not_see_it(api: Api):
    from support.api import STRANGER_KEY

    assert actions(api.other(STRANGER_KEY)) == []


def test_the_head_of_a_log_is_one_row_per_tenant(api: Api):
    with api.services.database.read() as connection:
        assert len(connection.execute(rows(TENANT, audit_heads)).all()) == 1
