"""Organisations, users with roles, keys: the commands of operators, and what they mean for requests."""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from lambent_server.accounts import audit, keys, users
from lambent_server.core.clock import now
from lambent_server.database.people_schema import members
from lambent_server.database.schema import api_keys, sessions
from lambent_server.database.tenancy import Tenant, change, rows
from lambent_server.http.identity import COOKIE, open_session
from sqlalchemy import delete
from starlette.testclient import TestClient
from support.admin import admin, administered, listed
from support.api import TENANT, Api, expect, expect_problem

STUDIO = Tenant("studio")
CSRF = {"x-lambent-csrf": "1"}


@pytest.fixture
def api(tmp_path: Path) -> Iterator[Api]:
    with administered(tmp_path / "data") as api:
        yield api


def browser_of(api: Api, email: str, tenant: Tenant) -> TestClient:
    """Return a browser in which this user has signed in."""
    with api.services.database.write() as connection:
        user_id = users.require(connection, email).id
        token = open_session(connection, tenant, 60.0, user_id)
    browser = api.other(None)
    browser.cookies.set(COOKIE, token, domain="localhost.local")
    browser.headers |= CSRF
    return browser


def with_studio(api: Api, role: str = "editor") -> TestClient:
    admin(api, "org", "create", "studio", "--name", "The Studio")
    admin(api, "user", "add", "Anna@Example.com", "--org", "studio", "--role", role, "--name", "Anna")
    return browser_of(api, "anna@example.com", STUDIO)


def test_an_organisation_is_made_listed_closed_and_opened(api: Api):
    admin(api, "org", "create", "studio", "--name", "The Studio")
    assert "organisation_exists" in admin(api, "org", "create", "studio", code=4).stderr
    admin(api, "org", "create", "Studio!", code=2)
    key = admin(api, "key", "create", "robot", "--org", "studio", "--scope", "read").stdout.strip()
    expect(api.other(key).get("/v1/scenes"), 200)
    admin(api, "org", "close", "studio")
    expect_problem(api.other(key).get("/v1/scenes"), 401, "not_authenticated")
    found = {each["id"]: each for each in listed(api, "org", "list")}
    assert (found["studio"]["closed"], found["default"]["closed"]) == (True, False)
    admin(api, "org", "open", "studio")
    expect(api.other(key).get("/v1/scenes"), 200)
    assert "The Studio" in admin(api, "org", "list").stdout
    assert "organisation_not_found" in admin(api, "org", "close", "nobody", code=4).stderr


def test_what_one_organisation_has_another_does_not_see(api: Api):
    anna = with_studio(api)
    scene = api.scene()
    assert expect(anna.get("/v1/scenes"), 200)["items"] == []
    expect_problem(anna.get(f"/v1/scenes/{scene}"), 404, "scene_not_found")
    expect_problem(anna.delete(f"/v1/scenes/{scene}"), 404, "scene_not_found")


@pytest.mark.parametrize(
    ("role", "may"),
    [("viewer", ()), ("editor", ("/v1/scenes",)), ("admin", ("/v1/scenes", "/v1/login-links"))],
)
def test_a_role_decides_what_a_user_may_do(api: Api, role: str, may: tuple[str, ...]):
    anna = with_studio(api, role)
    expect(anna.get("/v1/scenes"), 200)
    for path, body in (("/v1/scenes", {"name": "s"}), ("/v1/login-links", None)):
        answer = anna.post(path, json=body)
        if path in may:
            expect(answer, 201)
        else:
            expect_problem(answer, 403, "scope_missing")
    # A session yields nothing lasting, whatever its role.
    code = "key_needed" if role == "admin" else "scope_missing"
    expect_problem(anna.post("/v1/keys", json={"name": "k"}), 403, code)


def test_a_new_role_holds_at_once_and_who_leaves_is_out_at_once(api: Api):
    anna = with_studio(api)
    expect(anna.post("/v1/scenes", json={"name": "s"}), 201)
    admin(api, "user", "add", "anna@example.com", "--org", "studio", "--role", "viewer")
    expect_problem(anna.post("/v1/scenes", json={"name": "s"}), 403, "scope_missing")
    key = admin(api, "key", "create", "hers", "--org", "studio", "--user", "anna@example.com").stdout.strip()
    expect(api.other(key).get("/v1/scenes"), 200)
    admin(api, "user", "remove", "anna@example.com", "--org", "studio")
    expect_problem(anna.get("/v1/scenes"), 401, "not_authenticated")
    expect_problem(api.other(key).get("/v1/scenes"), 401, "not_authenticated")
    assert (
        "member_not_found"
        in admin(api, "user", "remove", "anna@example.com", "--org", "studio", code=4).stderr
    )


def test_who_is_disabled_is_out_everywhere(api: Api):
    anna = with_studio(api)
    admin(api, "user", "disable", "anna@example.com")
    expect_problem(anna.get("/v1/scenes"), 401, "not_authenticated")
    # A session that was made in between does not help.
    again = browser_of(api, "anna@example.com", STUDIO)
    expect_problem(again.get("/v1/scenes"), 401, "not_authenticated")
    admin(api, "user", "enable", "anna@example.com")
    expect(again.get("/v1/scenes"), 200)


def key_of(api: Api, email: str, *arguments: str) -> TestClient:
    """Return a client with a key of this member of the studio."""
    made = admin(api, "key", "create", "hers", "--org", "studio", "--user", email, *arguments)
    return api.other(made.stdout.strip())


def test_a_key_of_a_person_may_do_no_more_than_the_person(api: Api):
    with_studio(api, "viewer")
    key = key_of(api, "anna@example.com")
    submit_only = key_of(api, "anna@example.com", "--scope", "submit")
    expect(key.get("/v1/scenes"), 200)
    expect_problem(key.post("/v1/scenes", json={"name": "s"}), 403, "scope_missing")
    expect_problem(submit_only.post("/v1/scenes", json={"name": "s"}), 403, "scope_missing")
    admin(api, "user", "add", "anna@example.com", "--org", "studio", "--role", "editor")
    expect(key.post("/v1/scenes", json={"name": "s"}), 201)
    expect_problem(submit_only.get("/v1/scenes"), 403, "scope_missing")
    expect_problem(key.get("/v1/keys"), 403, "scope_missing")


@pytest.mark.parametrize("column", ["disabled", "no member"])
def test_a_key_of_somebody_who_may_not_come_in_is_refused_though_it_is_not_revoked(api: Api, column: str):
    with_studio(api, "admin")
    key = key_of(api, "anna@example.com")
    expect(key.get("/v1/scenes"), 200)
    with api.services.database.write() as connection:
        user_id = users.require(connection, "anna@example.com").id
        if column == "disabled":
            users.change_user(connection, user_id, disabled_at=1.0)
        else:
            connection.execute(delete(members).where(members.c.user_id == user_id))
    expect_problem(key.get("/v1/scenes"), 401, "not_authenticated")


def open_link(api: Api, maker: TestClient, *, status: int = 204) -> TestClient:
    """Return a browser that has opened a one-time link of `maker`."""
    return use_link(api, make_link(maker), status=status)


def make_link(maker: TestClient) -> str:
    return str(expect(maker.post("/v1/login-links"), 201)["url"]).partition("code=")[2]


def use_link(api: Api, code: str, *, status: int = 204) -> TestClient:
    browser = api.other(None)
    browser.headers |= CSRF
    assert browser.post("/v1/login", json={"code": code}).status_code == status
    return browser


LEAVING: dict[str, tuple[str, ...]] = {
    "removed": ("user", "remove", "anna@example.com", "--org", "studio"),
    "disabled": ("user", "disable", "anna@example.com"),
    "deleted": ("user", "delete", "anna@example.com", "--yes"),
    "no admin": ("user", "add", "anna@example.com", "--org", "studio", "--role", "editor"),
}


@pytest.mark.parametrize("how", LEAVING)
def test_login_links_end_with_whoever_made_them(api: Api, how: str):
    anna = with_studio(api, "admin")
    key = key_of(api, "anna@example.com")
    other = admin(api, "key", "create", "robot", "--org", "studio").stdout.strip()
    first = open_link(api, anna)
    # Links of a link's browser, and of her key, are hers too.
    browsers = [first, open_link(api, first), open_link(api, key)]
    stays = open_link(api, api.other(other))
    unused = [make_link(maker) for maker in (anna, first, key)]
    for browser in (*browsers, stays):
        expect(browser.get("/v1/scenes"), 200)
    admin(api, *LEAVING[how])
    for browser in browsers:
        expect_problem(browser.get("/v1/scenes"), 401, "not_authenticated")
    for code in unused:
        use_link(api, code, status=401)
    expect(stays.get("/v1/scenes"), 200)
    if how in ("removed", "disabled"):
        # For good: who comes back has to make new ones.
        admin(api, "user", "add", "anna@example.com", "--org", "studio", "--role", "admin")
        admin(api, "user", "enable", "anna@example.com")
        expect_problem(first.get("/v1/scenes"), 401, "not_authenticated")


def test_a_link_of_a_disabled_user_is_invalid_even_if_its_session_is_still_stored(api: Api):
    anna = with_studio(api, "admin")
    browser, code = open_link(api, anna), make_link(anna)
    with api.services.database.write() as connection:
        users.change_user(connection, users.require(connection, "anna@example.com").id, disabled_at=1.0)
    expect_problem(browser.get("/v1/scenes"), 401, "not_authenticated")
    use_link(api, code, status=401)


def test_a_link_of_an_expired_key_ends_with_it(api: Api):
    made = expect(api.post("/v1/keys", json={"name": "k", "expires_in_s": 60}), 201)
    browser = open_link(api, api.other(made["key"]))
    expect(browser.get("/v1/scenes"), 200)
    with api.services.database.write() as connection:
        connection.execute(change(TENANT, api_keys).where(api_keys.c.id == made["id"]).values(expires_at=1.0))
    expect_problem(browser.get("/v1/scenes"), 401, "not_authenticated")


def test_switching_makes_no_session_longer(api: Api):
    anna = with_studio(api)
    admin(api, "user", "add", "anna@example.com", "--org", "default")
    answer = anna.post("/v1/me:switch", json={"organisation": "default"})
    expect(answer, 200)
    assert 0 < int(answer.headers["set-cookie"].partition("Max-Age=")[2].partition(";")[0]) <= 60
    with api.services.database.read() as connection:
        (until,) = connection.execute(rows(TENANT, sessions, sessions.c.expires_at)).scalars()
    assert until - now() <= 60


def test_a_user_of_several_organisations_switches(api: Api):
    anna = with_studio(api)
    admin(api, "user", "add", "anna@example.com", "--org", "default", "--role", "viewer")
    me = expect(anna.get("/v1/me"), 200)
    assert (me["name"], me["organisation"], me["organisation_name"]) == ("Anna", "studio", "The Studio")
    assert {each["id"]: each["role"] for each in me["organisations"]} == {
        "default": "viewer",
        "studio": "editor",
    }
    scene = api.scene()
    before = anna.cookies[COOKIE]
    there = expect(anna.post("/v1/me:switch", json={"organisation": "default"}), 200)
    assert (there["organisation"], there["scopes"]) == ("default", ["read"])
    expect(anna.get(f"/v1/scenes/{scene}"), 200)
    assert anna.cookies[COOKIE] != before
    old = api.other(None)
    old.cookies.set(COOKIE, before)
    expect_problem(old.get("/v1/me"), 401, "not_authenticated")
    expect_problem(
        anna.post("/v1/me:switch", json={"organisation": "stranger"}), 404, "organisation_not_found"
    )
    expect_problem(api.post("/v1/me:switch", json={"organisation": "studio"}), 409, "no_user")
    with api.services.database.read() as connection:
        entries = [entry.action for entry in audit.entries(connection, TENANT)]
    assert "switch_organisation" in entries


def test_a_browser_of_a_one_time_link_is_out_when_a_key_is_revoked_and_a_user_is_not(api: Api):
    anna = with_studio(api)
    code = expect(api.post("/v1/login-links"), 201)["url"].partition("code=")[2]
    visitor = api.other(None)
    expect(visitor.post("/v1/login", json={"code": code}), 204)
    assert expect(visitor.get("/v1/me"), 200)["kind"] == "session"
    for org in ("default", "studio"):
        key = admin(api, "key", "create", "k", "--org", org)
        assert key.stdout.startswith("lk_")
    for each in listed(api, "key", "list"):
        if each["name"] == "k":
            admin(api, "key", "revoke", each["id"])
    expect_problem(visitor.get("/v1/me"), 401, "not_authenticated")
    expect(anna.get("/v1/me"), 200)


def test_keys_are_made_with_scopes_and_an_end(api: Api):
    admin(api, "key", "create", "robot", "--scope", "read", "--scope", "submit", "--expires", "12h")
    (found,) = [each for each in listed(api, "key", "list", "--org", "default") if each["name"] == "robot"]
    assert found["scopes"] == ["read", "submit"]
    assert found["expires_at"] is not None
    admin(api, "key", "create", "robot", "--scope", "root", code=2)
    admin(api, "key", "create", "robot", "--org", "nobody", code=4)
    assert "key_not_found" in admin(api, "key", "revoke", "key_none", code=4).stderr


def test_what_happens_to_somebody_of_no_open_organisation_is_recorded_too(api: Api):
    with_studio(api)
    (user,) = listed(api, "user", "list")
    admin(api, "org", "close", "studio")
    for arguments in (("disable",), ("enable",), ("delete", "--yes")):
        admin(api, "user", arguments[0], "anna@example.com", *arguments[1:])
    lines = admin(api, "audit", "export", "--org", "-").stdout.splitlines()
    found = [(entry["action"], entry["target"]) for entry in map(json.loads, lines)]
    assert found == [(f"user {action}", user["id"]) for action in ("disable", "enable", "delete")]


def test_a_refusal_says_whom_to_ask(api: Api):
    anna = with_studio(api, "viewer")
    refused = expect_problem(anna.post("/v1/scenes", json={"name": "s"}), 403, "scope_missing")
    assert "ask an admin for the role with it" in refused["detail"]
    key = api.other(admin(api, "key", "create", "k", "--scope", "read").stdout.strip())
    refused = expect_problem(key.post("/v1/scenes", json={"name": "s"}), 403, "scope_missing")
    assert "ask an admin for a key with it" in refused["detail"]
    unknown = admin(api, "user", "add", "bob@example.com", "--org", "annex", code=4).stderr
    assert "lambent admin org create annex" in unknown


def test_a_mistyped_id_adds_nobody(api: Api):
    admin(api, "org", "create", "studio")
    refused = admin(api, "user", "add", "user_01J", "--org", "studio", code=4).stderr
    assert "there is no user 'user_01J', and a new one needs an e-mail address" in refused
    assert listed(api, "user", "list") == []
    admin(api, "user", "add", "anna@example.com", "--org", "studio")
    (user,) = listed(api, "user", "list")
    admin(api, "user", "add", user["id"], "--org", "default", "--role", "viewer")
    (user,) = listed(api, "user", "list")
    assert user["roles"] == {"default": "viewer", "studio": "editor"}


def test_entries_of_commands_and_of_paths_are_found(api: Api):
    admin(api, "quota", "default", "--jobs", "5")
    admin(api, "retention", "set", "default", "--jobs", "5d")
    reader = api.other(expect(api.post("/v1/keys", json={"name": "k", "scopes": ["read"]}), 201)["key"])
    expect_problem(reader.post("/v1/scenes", json={"name": "s"}), 403, "scope_missing")
    for given in ({"action": "retention set"}, {"target": "/v1/scenes"}):
        (found,) = expect(api.get("/v1/audit", params=given), 200)["items"]
        assert {name: found[name] for name in given} == given
    for text in ("", "a\nb", "x" * 201):
        expect_problem(api.get("/v1/audit", params={"action": text}), 422, "invalid_request")


def test_a_login_link_of_a_closed_organisation_opens_nothing(api: Api):
    anna = with_studio(api, "admin")
    code = make_link(anna)
    admin(api, "org", "close", "studio")
    use_link(api, code, status=401)
    admin(api, "org", "open", "studio")
    use_link(api, code, status=401)
    lines = admin(api, "audit", "export", "--org", "-").stdout.splitlines()
    found = [(entry["action"], entry["outcome"]) for entry in map(json.loads, lines)]
    assert found == [("log_in", "login_code_invalid")]


def test_keys_of_no_organisation_open_nothing(api: Api):
    with api.services.database.write() as connection:
        made = keys.create(connection, Tenant("nobody"), keys.NewKey(name="k"))
    expect_problem(api.other(made.key).get("/v1/scenes"), 401, "not_authenticated")


def test_a_deleted_user_leaves_no_name_behind(api: Api):
    anna = with_studio(api)
    expect(anna.post("/v1/scenes", json={"name": "s"}), 201)
    (before,) = listed(api, "user", "list")
    admin(api, "user", "delete", "anna@example.com")
    assert listed(api, "user", "list") == [before]
    admin(api, "user", "delete", "anna@example.com", "--yes")
    assert listed(api, "user", "list") == []
    expect_problem(anna.get("/v1/scenes"), 401, "not_authenticated")
    export = admin(api, "audit", "export", "--org", "studio").stdout
    assert before["id"] in export
    assert "nna" not in export


def test_the_log_is_verified_exported_and_pruned(api: Api):
    api.scene()
    admin(api, "quota", "default", "--jobs", "5")
    (whole,) = listed(api, "audit", "verify", "--org", "default")
    assert whole["ok"]
    entries = [
        json.loads(line) for line in admin(api, "audit", "export", "--org", "default").stdout.splitlines()
    ]
    assert [entry["action"] for entry in entries][-1] == "quota"
    assert entries[-1]["actor_kind"] == "operator"
    assert entries[-1]["details"] == {"max_jobs": [None, 5]}
    admin(api, "audit", "verify", "--org", "default", "--expect", whole["head"])
    admin(api, "audit", "verify", "--org", "default", "--expect", "1:abc", code=1)
    admin(api, "audit", "prune", "--org", "default", "--older-than", "0s")
    assert len(admin(api, "audit", "export", "--org", "default").stdout.splitlines()) == len(entries)
    admin(api, "audit", "prune", "--org", "default", "--older-than", "0s", "--yes")
    (left,) = [json.loads(line) for line in admin(api, "audit", "export").stdout.splitlines()]
    assert (left["action"], left["details"]) == ("audit prune", {"entries": len(entries)})
    admin(api, "audit", "verify", "--org", "default", "--expect", whole["head"])


def test_quotas_are_set_shown_and_taken_back(api: Api):
    admin(api, "quota", "default", "--bytes", "80G", "--jobs", "7", "--gpu-minutes", "90")
    (shown,) = listed(api, "quota", "default")
    assert {name: each["limit"] for name, each in shown.items()} == {
        "bytes": 80e9,
        "jobs": 7,
        "gpu_minutes": 90,
    }
    assert "80000000000" in admin(api, "quota", "default").stdout
    admin(api, "quota", "default", "--default")
    (shown,) = listed(api, "quota", "default")
    assert {name: each["limit"] for name, each in shown.items()} == {
        "bytes": None,
        "jobs": 1000,
        "gpu_minutes": None,
    }
    admin(api, "quota", "default", "--bytes", "much", code=2)
    admin(api, "quota", "nobody", code=4)
