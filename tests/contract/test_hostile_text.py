"""Every operation with text that databases, headers and answers cannot hold: refused, and never a 5xx."""

import copy
import json
from collections.abc import Iterator
from contextlib import ExitStack
from typing import Any

import pytest
from lambent_server.app import describe
from support.api import KEY, Api, expect, opened
from support.databases import postgresql
from support.one_of_each import one_of_each

pytestmark = [pytest.mark.slow, pytest.mark.long]

OPERATIONS = [
    (path, method, operation)
    for path, operations in describe()["paths"].items()
    for method, operation in operations.items()
]
SCHEMAS = describe()["components"]["schemas"]
# As they are sent: in a path or a query, percent-encoded; in a header, as bytes.
TEXTS = {
    "a NUL": "%00",
    "a NUL inside": "job_%00x",
    "a byte that is not a UTF-8": "%ff",
    "half of a surrogate pair": "%ed%a0%80",
    "an overlong slash": "%c0%af",
    "a line break": "a%0d%0ab",
    "a letter that is not an ASCII": "%c3%a9",
    "a letter beyond the first plane": "%f0%9f%98%80",
    "an integer of 64 bits": "9223372036854775807",
    "a larger integer": "9" * 400,
    "a negative one": "-9223372036854775809",
    "a number that overflows": "1e999",
    "no number": "NaN",
    "nothing": "",
    "much": "a" * 3000,
    "quotes": "%27%22%5c%25_",
    "brackets": "%5b" * 600,
    "the first year": "0001-01-01T00:00:00%2B23:59",
    "the last year": "9999-12-31T23:59:59-23:59",
}
JSON = {
    "a NUL": r'"a\u0000b"',
    "half of a surrogate pair": r'"\ud800"',
    "the other half": r'"\udfff\ud800"',
    "bytes that are not UTF-8": '"\udcff"',
    "a control character": r'"\u0001\u001b\u007f"',
    "letters": r'"é😀\u202e\u200b\ufeff"',
    "an integer of 64 bits": "9223372036854775807",
    "a larger integer": "9" * 400,
    "an integer of thousands of digits": "9" * 5000,
    "a number that overflows": "1e999",
    "a float": "1.5e300",
    "no number": "NaN",
    "null": "null",
    "true": "true",
    "much": '"' + "a" * 70_000 + '"',
    "lists in lists": "[" * 900 + "]" * 900,
    "lists in too many lists": "[" * 200_000,
    "objects in objects": '{"a":' * 900 + "1" + "}" * 900,
    "a name that is not a text": r'{"\ud800":"a","\u0000":"b"}',
    "a name with text": r'{"a":"\u0000"}',
    "a list of text": r'["\u0000","\ud800"]',
}


@pytest.fixture(scope="module", params=["sqlite", "postgresql"])
def known(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """Return an interface on a database of each kind, and the ids of one thing of every kind."""
    folder = tmp_path_factory.mktemp(request.param) / "data"
    with ExitStack() as stack:
        given = {"database": stack.enter_context(postgresql())} if request.param == "postgresql" else {}
        # Nothing here is about how much one may ask for.
        rates = {"client_writes_per_s": 0, "organisation_writes_per_s": 0, "sign_ins_per_s": 0}
        api = stack.enter_context(opened(folder, max_wait_s=0.01, **rates, **given))
        ids = {**one_of_each(api, folder), "path": "manifest.json"}
        # Not the key of the test, which would be revoked.
        ids["key_id"] = expect(api.post("/v1/keys", json={"name": "another"}), 201)["id"]
        yield api, ids


def assert_refused_or_taken(answer: Any, *about: Any) -> None:
    """Check that an answer is not a failure of the server, and a whole document."""
    assert answer.status_code < 500 or answer.json()["code"] == "decoder_busy", (*about, answer.text[:500])
    if answer.status_code >= 400 and answer.content:
        assert b"not_authenticated" not in answer.content, about
        kind = answer.headers["content-type"]
        assert kind in ("application/problem+json", "text/html; charset=utf-8"), about
        answer.content.decode("utf-8")


def send(api: Api, method: str, url: str, **kwargs: Any) -> Any:
    """Send a request as HEAD where it would be a stream."""
    stream = url.partition("?")[0] == "/v1/events"
    return api.request("HEAD" if stream else method.upper(), url, follow_redirects=False, **kwargs)


@pytest.mark.parametrize(("path", "method"), [(path, method) for path, method, _ in OPERATIONS])
def test_no_path_query_or_header_makes_the_server_fail(known: Any, path: str, method: str):
    api, ids = known
    operation = next(each for a, b, each in OPERATIONS if (a, b) == (path, method))
    content = {"content": b"{}", "headers": {"content-type": "application/json"}} if method != "get" else {}
    parameters = operation.get("parameters", [])
    for name in [each["name"] for each in parameters if each["in"] == "path"]:
        for title, text in TEXTS.items():
            url = path.format(**{**ids, name: text})
            assert_refused_or_taken(send(api, method, url, **content), title, url)
    url = path.format(**ids)
    for name in [*(each["name"] for each in parameters if each["in"] == "query"), "unknown"]:
        for title, text in TEXTS.items():
            reading = "head" if method == "get" else method
            for query in (f"{name}={text}", *([f"{text}={text}"] if name == "unknown" else [])):
                answer = send(api, reading, f"{url}?{query}", **content)
                assert_refused_or_taken(answer, title, query)
    if method == "delete":
        return
    headers = [each["name"] for each in parameters if each["in"] == "header"]
    for name in (*headers, "Cookie", "Range", "Accept", "Origin", "Content-Type", "If-Modified-Since"):
        for value in (
            b"\xff",
            b"\xe9",
            b"a" * 3000,
            b"9" * 400,
            b'"' * 50,
            b"=;,:" * 40,
            b"bytes=9-" + b"9" * 150,
            b'lambent_session="\\000\\377"',
        ):
            pairs = [(b"authorization", f"Bearer {KEY}".encode()), (name.encode(), value)]
            assert_refused_or_taken(send(api, method, url, headers=pairs), name, value)


def leaves(schema: Any, depth: int = 0) -> Iterator[tuple[Any, ...]]:
    """Yield the places of values in the body of a schema, as keys and indices."""
    if "$ref" in schema:
        schema = SCHEMAS[schema["$ref"].rpartition("/")[2]]
    yield ()
    if depth > 4:
        return
    for name, each in schema.get("properties", {}).items():
        yield from ((name, *rest) for rest in leaves(each, depth + 1))
    for pattern in (schema.get("patternProperties") or {}).values():
        yield from (("name", *rest) for rest in leaves(pattern, depth + 1))
    if isinstance(schema.get("additionalProperties"), dict):
        yield from (("name", *rest) for rest in leaves(schema["additionalProperties"], depth + 1))
    if "items" in schema:
        yield from ((0, *rest) for rest in leaves(schema["items"], depth + 1))
    for each in (*schema.get("anyOf", []), *schema.get("oneOf", [])):
        yield from leaves(each, depth + 1)


BODIES: dict[str, Any] = {
    "/v1/scenes": {"name": "a"},
    "/v1/jobs": {"scene_id": "x", "preset": "tiny"},
    "/v1/webhooks": {"url": "https://example.com/"},
    "/v1/keys": {"name": "a"},
    "/v1/estimates": {"preset": "tiny"},
}
MARK = "the value goes here"


def with_mark(body: Any, place: tuple[Any, ...]) -> Any:
    """Return a body with a mark at a place, and what leads there."""
    if not place:
        return MARK
    first, *rest = place
    if isinstance(first, int):
        return [with_mark(None, tuple(rest))]
    body = copy.deepcopy(body) if isinstance(body, dict) else {}
    return {**body, first: with_mark(body.get(first), tuple(rest))}


@pytest.mark.parametrize(
    ("path", "method"),
    [
        (path, method)
        for path, method, operation in OPERATIONS
        if "application/json" in operation.get("requestBody", {}).get("content", {})
    ],
)
def test_no_body_makes_the_server_fail(known: Any, path: str, method: str):
    api, ids = known
    operation = next(each for a, b, each in OPERATIONS if (a, b) == (path, method))
    schema = operation["requestBody"]["content"]["application/json"]["schema"]
    body = {**BODIES.get(path, {})}
    if "scene_id" in body:
        body["scene_id"] = ids["scene_id"]
    places = sorted(set(leaves(schema)), key=str)
    for place in places:
        text = json.dumps(with_mark(body, place))
        for title, value in JSON.items():
            # Bytes that are not UTF-8 come as half of a pair here.
            sent = text.replace(f'"{MARK}"', value).encode("utf-8", "surrogateescape")
            headers = {"content-type": "application/json"}
            answer = send(api, method, path.format(**ids), content=sent, headers=headers)
            assert_refused_or_taken(answer, place, title)
            if title in (
                "a NUL",
                "half of a surrogate pair",
                "a number that overflows",
                "no number",
                "a larger integer",
            ):
                # 401: who is asked for a code has to send a text first, too.
                assert answer.status_code == 400, (place, title, answer.text[:300])


@pytest.mark.parametrize(
    "path", ["/embed/%00", "/embed/%00/picture", "/embed/%ff", "/%00", "/assets/%00", "/a%0ab"]
)
def test_the_pages_refuse_it_without_a_key(known: Any, path: str):
    assert known[0].other(None).get(path).status_code == 400
