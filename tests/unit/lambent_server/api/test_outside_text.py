"""Text from outside: what is text, JSON and a media type, and what is refused."""

import json

import pytest
from lambent_server.api.outside_text import (
    MAX_INTEGER,
    OCTETS,
    check_target,
    media_type,
    parse_json,
    plain,
    refuse_form,
    sendable_media_type,
)
from lambent_server.api.problems import Problem


def refused(body: bytes) -> Problem:
    """Return the problem of a JSON body."""
    with pytest.raises(Problem) as caught:
        parse_json(body)
    assert caught.value.status == 400
    return caught.value


def test_json_is_read_as_the_standard_library_reads_it():
    value = {"a": [1, -2.5, "é\n", None, True], "b": {"": "😀", "e": 1e300}, "c": MAX_INTEGER}
    for text in (json.dumps(value), json.dumps(value, ensure_ascii=False), "\ufeff" + json.dumps(value)):
        assert parse_json(text.encode()) == value


@pytest.mark.parametrize(
    "body",
    [
        b"",
        b"{",
        b'{"a":NaN}',
        b"[Infinity]",
        b"-Infinity",
        b'"\xff"',
        b'"\xed\xa0\x80"',
        '{"a": 1}'.encode("utf-16"),
        b'"\x00"',
        b"[" * 100_000,
        b'{"a":' * 5000 + b"1" + b"}" * 5000,
        b"9" * 5000,
    ],
)
def test_what_is_no_json_is_refused_as_such(body: bytes):
    assert refused(body).code == "invalid_json"


@pytest.mark.parametrize(
    ("body", "pointer"),
    [
        (rb'{"a":["x","\u0000"]}', "#/a/1"),
        (rb'{"a":{"b/c":"\ud800"}}', "#/a/b~1c"),
        (rb'"\uDFFF"', "#"),
        (rb'["\udc00\ud800"]', "#/0"),
        (rb'{"\u0000":1}', "#"),
        (rb'{"a":{"\ud800":1}}', "#/a"),
        (b'{"a":9223372036854775808}', "#/a"),
        (b"[-9223372036854775809]", "#/0"),
        (b'{"a":1e309}', "#/a"),
        (b"[1" + b"0" * 400 + b".0]", "#/0"),
    ],
)
def test_what_cannot_be_stored_is_refused_with_its_place(body: bytes, pointer: str):
    problem = refused(body)
    assert (problem.code, problem.errors[0].pointer) == ("text_invalid", pointer)
    # The answer itself has to be text.
    json.dumps(problem.document("req_x"), ensure_ascii=False).encode()


def test_pairs_of_surrogates_and_long_fractions_are_text_and_numbers():
    assert parse_json(rb'["\ud83d\ude00", 0.1234567890123456789012, 1e-400, 12345678901234567]')


def test_targets_are_text_in_utf_8():
    check_target(b"/v1/bundles/b/files/%C3%A9%20%25.png", b"q=%0A&label=a%3D%F0%9F%98%80")
    bad = [(b"/%00", b""), (b"/%ff", b""), (b"/%c0%80", b""), (b"/%1f", b""), (b"/%7F", b"")]
    bad += [(b"/", b"a=%00"), (b"/", b"%fe"), (b"/", b"a=%ed%bf%bf")]
    for path, query in bad:
        with pytest.raises(Problem) as caught:
            check_target(path, query)
        assert (caught.value.status, caught.value.code) == (400, "target_invalid")


@pytest.mark.parametrize(
    "text",
    [
        "image/png",
        "text/plain; charset=utf-8",
        'text/plain;a="b \\" c"',
        "application/vnd.a+json",
        "a/b ;c=d",
    ],
)
def test_media_types_follow_the_grammar(text: str):
    assert media_type(f" {text}\t") == text
    assert sendable_media_type(text) == text


@pytest.mark.parametrize(
    "text",
    [
        *("image", "image/", "/png", "image/png\r\nx: y", "image/png\n", "image/png\0", "im age/png"),
        *("image/png;", "image/png; a", 'a/b;c="d', "a/b; c=é", "a/b, c/d", "a/" + "b" * 200, "ä/b"),
    ],
)
def test_other_texts_are_no_media_types(text: str):
    assert media_type(text) is None
    assert sendable_media_type(text) == OCTETS


def test_bytes_without_a_media_type_are_octets():
    assert media_type("") == OCTETS


def test_a_name_that_is_only_shown_keeps_what_is_text():
    assert plain("F\0ay \ud800\U0001f600") == "Fay \U0001f600"


def test_a_form_is_refused_with_how_to_send_a_file():
    for given in ("multipart/form-data; boundary=x", "Multipart/Mixed"):
        with pytest.raises(Problem) as caught:
            refuse_form(given)
        assert (caught.value.status, caught.value.code) == (415, "unsupported_media_type")
        assert "curl -T" in caught.value.detail
    for given in ("", "application/zip", "application/x-www-form-urlencoded"):
        refuse_form(given)
