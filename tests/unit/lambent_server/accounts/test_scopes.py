"""Every operation declares the scope that it needs, and keys without it are refused by its name."""

from collections.abc import Iterator

import pytest
from fastapi import APIRouter
from lambent_server.accounts.scopes import ALL, ROLES, joined, of_role, parsed
from lambent_server.app import describe
from lambent_server.http.request import PUBLIC
from lambent_server.http.scopes import SCOPES, require_complete
from support.api import Api, expect, expect_problem, opened

DESCRIPTION = describe()
OPERATIONS = [
    (path, method, operation)
    for path, operations in DESCRIPTION["paths"].items()
    for method, operation in operations.items()
]
# Operations that can be called without a body, on things that do not exist.
PLACES = {
    "sha256": "0" * 64,
    "path": "manifest.json",
}


@pytest.fixture(scope="module")
def api(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Api]:
    with opened(tmp_path_factory.mktemp("scopes") / "data") as api:
        yield api


def key_with(api: Api, *scopes: str) -> str:
    return str(expect(api.post("/v1/keys", json={"name": "k", "scopes": list(scopes)}), 201)["key"])


@pytest.mark.parametrize(("path", "method", "operation"), OPERATIONS)
def test_every_operation_declares_a_scope_or_is_public(path: str, method: str, operation: dict):
    scope = SCOPES[operation["operationId"]]
    if scope is None:
        assert PUBLIC.fullmatch(path), path
        assert "security" not in operation
        return
    assert not PUBLIC.fullmatch(path)
    assert operation["security"] == [{"key": [scope]}, {"session": [scope]}]
    assert f"Needs the scope `{scope}`." in operation["description"]


def test_the_application_does_not_start_with_a_route_that_declares_none():
    router = APIRouter()
    router.add_api_route("/v1/secret", lambda: None, name="forgotten")
    with pytest.raises(LookupError, match="forgotten"):
        require_complete([router])


@pytest.mark.parametrize(
    ("path", "method", "operation"), [each for each in OPERATIONS if SCOPES[each[2]["operationId"]]]
)
def test_a_key_without_the_scope_is_refused_by_name(api: Api, path: str, method: str, operation: dict):
    scope = SCOPES[operation["operationId"]]
    names = {each["name"]: "x" for each in operation.get("parameters", ()) if each["in"] == "path"}
    place = path.format(**{**names, **{name: PLACES[name] for name in names if name in PLACES}})
    others = api.other(key_with(api, *(ALL - {scope})))
    body = {"json": {}} if "requestBody" in operation else {}
    problem = expect_problem(others.request(method, place, **body), 403, "scope_missing")
    assert problem["scope"] == scope
    assert repr(scope) in problem["detail"]
    if path == "/v1/events":
        return
    answer = api.other(key_with(api, scope)).request(method, place, **body)
    assert answer.status_code != 403 or answer.json()["code"] != "scope_missing"


def test_old_keys_have_all_scopes(api: Api):
    # As the fixture has written them: without any.
    assert expect(api.get("/v1/me"), 200)["scopes"] == sorted(ALL)


def test_a_new_key_without_scopes_in_the_request_has_all(api: Api):
    made = expect(api.post("/v1/keys", json={"name": "all"}), 201)
    assert made["scopes"] == sorted(ALL)


def test_a_replaced_key_keeps_its_scopes_and_expiry(api: Api):
    made = expect(api.post("/v1/keys", json={"name": "r", "scopes": ["read"], "expires_in_s": 600}), 201)
    fresh = expect(api.post(f"/v1/keys/{made['id']}:rotate"), 201)
    assert (fresh["scopes"], fresh["expires_at"]) == (["read"], made["expires_at"])


@pytest.mark.parametrize("scopes", [[], ["root"], ["read", "READ"]])
def test_unknown_scopes_are_refused(api: Api, scopes: list[str]):
    expect_problem(api.post("/v1/keys", json={"name": "k", "scopes": scopes}), 422, "invalid_request")


def test_roles_stand_for_scopes():
    assert of_role("viewer") == {"read"}
    assert of_role("editor") == {"read", "submit", "render"}
    assert of_role("admin") == ALL
    assert of_role("root") == frozenset()
    assert list(ROLES) == ["viewer", "editor", "admin"]


def test_stored_scopes_that_are_not_known_give_nothing():
    assert parsed("read root") == {"read"}
    assert parsed("") == frozenset()
    assert parsed(joined(["submit", "read", "read"])) == {"read", "submit"}
    assert parsed(None) == ALL
