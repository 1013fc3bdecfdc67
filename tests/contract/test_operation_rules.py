"""Every operation keeps the rules of the interface, new ones too: keys, pages, entity tags."""

from collections.abc import Iterator
from typing import Any

import pytest
from lambent_server import provenance
from lambent_server.app import describe
from support.api import STRANGER_KEY, TENANT, Api, expect, expect_problem, opened
from support.one_of_each import one_of_each

DESCRIPTION = describe()
OPERATIONS = [
    (path, method, operation)
    for path, operations in DESCRIPTION["paths"].items()
    for method, operation in operations.items()
    if path.startswith("/v1/")
]
# A login link is made in memory, and another one harms nobody. A second ping is another ping.
MAKES_ANEW = {"/v1/login-links", "/v1/webhooks/{webhook_id}:ping"}
# Actions on something that exists: repeating them changes nothing, or is refused by its state.
REPEATABLE_ACTIONS = {
    "/v1/jobs/{job_id}:cancel",
    "/v1/batches/{batch_id}:cancel",
    "/v1/batches/{batch_id}:retry",
    "/v1/deliveries/{delivery_id}:redeliver",
    "/v1/keys/{key_id}:rotate",
}
# A list that is part of the program, not of the data.
FIXED_LISTS = {"/v1/presets"}


def headers_of(operation: dict[str, Any]) -> set[str]:
    """Return the header parameters of an operation."""
    return {each["name"] for each in operation.get("parameters", ()) if each["in"] == "header"}


def schema_of(operation: dict[str, Any], status: str = "200") -> dict[str, Any]:
    """Return the schema of a JSON answer; {} if there is none."""
    content = operation["responses"].get(status, {}).get("content", {}).get("application/json", {})
    name = content.get("schema", {}).get("$ref", "").rpartition("/")[2]
    return DESCRIPTION["components"]["schemas"].get(name, {})


CREATES = [
    path
    for path, method, operation in OPERATIONS
    if method == "post" and {"201", "202"} & set(operation["responses"])
]
LISTS = [
    path
    for path, method, operation in OPERATIONS
    if method == "get" and "items" in schema_of(operation).get("properties", {})
]
JSON_READS = [path for path, method, operation in OPERATIONS if method == "get" and schema_of(operation)]
CHANGES = [path for path, method, _ in OPERATIONS if method == "patch"]


@pytest.mark.parametrize("path", CREATES)
def test_what_makes_something_takes_an_idempotency_key(path: str):
    operation = DESCRIPTION["paths"][path]["post"]
    takes = "Idempotency-Key" in headers_of(operation)
    assert takes != (path in MAKES_ANEW | REPEATABLE_ACTIONS)
    assert not takes or "422" in operation["responses"]


@pytest.mark.parametrize("path", LISTS)
def test_lists_have_pages_with_opaque_cursors(path: str):
    if path in FIXED_LISTS:
        return
    operation = DESCRIPTION["paths"][path]["get"]
    parameters = {each["name"]: each for each in operation["parameters"] if each["in"] == "query"}
    assert {"limit", "cursor"} <= set(parameters)
    assert "maximum" in parameters["limit"]["schema"]
    assert "next_cursor" in schema_of(operation)["required"]


@pytest.mark.parametrize("path", JSON_READS)
def test_reads_of_json_are_conditional(path: str):
    operation = DESCRIPTION["paths"][path]["get"]
    assert "If-None-Match" in headers_of(operation)
    assert "ETag" in operation["responses"]["200"]["headers"]
    assert "304" in operation["responses"]


@pytest.mark.parametrize("path", CHANGES)
def test_changes_of_something_can_be_conditional(path: str):
    operation = DESCRIPTION["paths"][path]["patch"]
    assert "If-Match" in headers_of(operation)
    assert "412" in operation["responses"]
    assert "get" in DESCRIPTION["paths"][path], "what can be changed can be read, with its ETag"


@pytest.fixture(scope="module")
def known(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Api, dict[str, str]]]:
    """Return the interface, and the ids of one thing of every kind."""
    folder = tmp_path_factory.mktemp("rules") / "data"
    with opened(folder) as api:
        ids = one_of_each(api, folder)
        with api.services.database.write() as connection:
            provenance.store(connection, TENANT, ids["bundle_id"], api.services.signer.envelope({}))
        yield api, ids


@pytest.mark.parametrize("path", JSON_READS)
def test_the_same_read_again_is_answered_without_a_body(known: tuple[Api, dict[str, str]], path: str):
    api, ids = known
    place = path.format(**ids)
    first = api.get(place)
    expect(first, 200)
    tag = first.headers["etag"]
    assert first.headers["cache-control"] == "private, no-cache"
    for header in (tag, f'"other", {tag}', f"W/{tag}", "*"):
        again = api.get(place, headers={"If-None-Match": header})
        assert (again.status_code, again.content, again.headers["etag"]) == (304, b"", tag), header
    expect(api.get(place, headers={"If-None-Match": '"other"'}), 200)


VALUES = {
    "/v1/scenes/{scene_id}": {"name": "another name"},
    "/v1/jobs/{job_id}": {"priority": 7},
    "/v1/bundles/{bundle_id}": {"labels": {"a": "b"}},
    "/v1/webhooks/{webhook_id}": {"name": "another name"},
}


@pytest.mark.parametrize("path", CHANGES)
def test_a_change_based_on_an_old_state_is_refused(known: tuple[Api, dict[str, str]], path: str):
    api, ids = known
    place = path.format(**ids)
    before = api.get(place)
    tag = before.headers["etag"]
    for other in ('"old"', "", ",", f"W/{tag}"):
        refused = api.patch(place, json=VALUES[path], headers={"If-Match": other})
        expect_problem(refused, 412, "precondition_failed")
    assert api.get(place).json() == before.json()
    changed = api.patch(place, json=VALUES[path], headers={"If-Match": tag})
    assert expect(changed, 200) == api.get(place).json() != before.json()
    assert changed.headers["etag"] == api.get(place).headers["etag"] != tag
    expect_problem(api.patch(place, json=VALUES[path], headers={"If-Match": tag}), 412, "precondition_failed")
    expect(api.patch(place, json=VALUES[path], headers={"If-Match": "*"}), 200)


BODIES: dict[str, dict[str, Any]] = {
    "/v1/scenes": {"json": {"name": "twice"}},
    "/v1/keys": {"json": {"name": "twice"}},
    "/v1/webhooks": {"json": {"url": "https://example.com/twice"}},
    "/v1/bundles/{bundle_id}/shares": {"json": {"expires_in_s": 3600}},
    "/v1/environments": {
        "params": {"name": "twice"},
        "content": b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 2\n" + bytes(8),
    },
    "/v1/jobs": {"json": {"scene_id": "{scene_id}", "preset": "tiny"}},
    "/v1/renders": {
        "json": {
            "bundle_id": "bundle_x",
            "environments": [{"environment_id": "{environment_id}"}],
            "cameras": {"turntable": 1},
        }
    },
    "/v1/batches": {
        "json": {
            "assets": [{"bundle_id": "bundle_x"}],
            "environments": [{"environment_id": "{environment_id}"}],
            "cameras": [{"turntable": 1}],
        }
    },
    "/v1/jobs/{job_id}:retry": {},
}


def filled(value: Any, ids: dict[str, str]) -> Any:
    """Return a body with ids of things that exist."""
    if isinstance(value, dict):
        return {name: filled(each, ids) for name, each in value.items()}
    if isinstance(value, list):
        return [filled(each, ids) for each in value]
    return value.format(**ids) if isinstance(value, str) else value


@pytest.mark.parametrize("path", [path for path in CREATES if path not in MAKES_ANEW | REPEATABLE_ACTIONS])
def test_the_same_request_with_the_same_key_makes_one_thing(known: tuple[Api, dict[str, str]], path: str):
    api, ids = known
    request = filled(BODIES[path], ids)
    if path.endswith(":retry"):
        ids = {**ids, "job_id": api.job(ids["scene_id"])["id"]}
        expect(api.post(f"/v1/jobs/{ids['job_id']}:cancel"), 202)
    headers = {"Idempotency-Key": f"once {path}".replace(" ", "-")}
    place = path.format(**ids)
    first = api.post(place, **request, headers=headers)
    assert first.status_code in (201, 202), first.text
    second = api.post(place, **request, headers=headers)
    assert second.status_code == first.status_code
    assert second.json()["id"] == first.json()["id"]
    if path == "/v1/keys":
        # Its secret is shown once, and not stored.
        assert second.json() == {**first.json(), "key": None}
    else:
        assert second.json() == first.json()
    expect_problem(
        api.post("/v1/scenes", json={"name": "something else"}, headers=headers),
        422,
        "idempotency_key_reused",
    )


FOREIGN = [
    (path, method)
    for path, method, operation in OPERATIONS
    if "_id}" in path and ("requestBody" not in operation or method == "patch")
]


@pytest.mark.parametrize(("path", "method"), FOREIGN)
def test_what_belongs_to_another_tenant_does_not_exist(
    known: tuple[Api, dict[str, str]], path: str, method: str
):
    api, ids = known
    place = path.format(**ids, path="manifest.json")
    stranger = api.other(STRANGER_KEY)
    answer = stranger.request(method, place, json=VALUES.get(path) if method == "patch" else None)
    assert answer.status_code == 404, answer.text
    assert expect_problem(answer, 404, answer.json()["code"])["code"].endswith("_not_found")
