"""Text from outside: what every request target, JSON body, cursor and media type must pass.

Refused is what a database or a header cannot hold: NUL, half of a surrogate pair, bytes that are not UTF-8,
control characters in paths, and numbers beyond 64 bits. A stricter pattern is a matter of each field.
"""

import json
import math
import re
from collections.abc import Iterator
from typing import Any
from urllib.parse import unquote_to_bytes

from starlette.datastructures import Headers

from lambent_server.api.problems import Detail, Problem

MAX_INTEGER = 2**63 - 1
OCTETS = "application/octet-stream"
MAX_MEDIA_TYPE = 200

_CONTROLS = re.compile(r"[\x00-\x1f\x7f]")
# RFC 9110, 8.3.1: two tokens, and parameters whose values are tokens or quoted strings.
_TOKEN = r"[!#$%&'*+.^_`|~0-9A-Za-z-]+"
_QUOTED = r'"(?:[\t \x21\x23-\x5b\x5d-\x7e]|\\[\t \x21-\x7e])*"'
_MEDIA_TYPE = re.compile(rf"{_TOKEN}/{_TOKEN}(?:[ \t]*;[ \t]*{_TOKEN}=(?:{_TOKEN}|{_QUOTED}))*")
# Only text with one of these can have a value to refuse: a list of a million files is not walked through.
_SUSPECT = re.compile(r"\\u(?:0000|[dD][89a-fA-F])|[0-9]{18}|[0-9][eE]\+?[0-9]{3}")


def announced_bytes(headers: Headers) -> int:
    """Return the size of its body that a request announces; 0 if it says none that is a number.

    More digits than any body has, which Python refuses to convert, count as the largest number.
    """
    text = headers.get("content-length", "")
    if not (text.isascii() and text.isdigit()):
        return 0
    return int(text) if len(text) < 20 else MAX_INTEGER


def storable(text: str) -> bool:
    """Return whether a database can hold a text: it has no NUL, and no half of a surrogate pair."""
    return "\0" not in text and not any("\ud800" <= letter <= "\udfff" for letter in text)


def plain(text: str) -> str:
    """Return a text that is only shown without what a database cannot hold."""
    return "".join(letter for letter in text if storable(letter))


def check_target(raw_path: bytes, query: bytes) -> None:
    """Refuse the path or the query of a request with `target_invalid` (400) if it is not text.

    Both as they were sent, percent-encoded: a decoder that is lenient replaces what is wrong.
    """
    path = _decoded(raw_path, "path")
    if _CONTROLS.search(path):
        raise _target("path", "a control character")
    if "\0" in _decoded(query, "query"):
        raise _target("query", "a NUL character (%00)")


def _decoded(data: bytes, part: str) -> str:
    try:
        return unquote_to_bytes(data).decode("utf-8")
    except UnicodeDecodeError as error:
        raise _target(part, "bytes that are not UTF-8") from error


def _target(part: str, fault: str) -> Problem:
    detail = f"the {part} of the request holds {fault}; encode text as UTF-8, then each byte as %XX"
    return Problem(400, "target_invalid", detail, errors=(Detail(f"#/{part}", fault),))


def parse_json(body: bytes) -> Any:
    """Return the value of a JSON text in UTF-8.

    Raises `invalid_json` (400) for what is not JSON or nested too deeply, and `text_invalid` (400), with a
    pointer, for strings and numbers that cannot be stored.
    """
    try:
        text = body.decode("utf-8-sig")
        value = json.loads(text, parse_constant=_refuse_constant)
    except UnicodeDecodeError as error:
        raise _not_json(f"byte {error.start} is not UTF-8") from error
    except json.JSONDecodeError as error:
        raise _not_json(f"{error.msg} at line {error.lineno}, column {error.colno}") from error
    except RecursionError as error:
        raise _not_json("it is nested too deeply") from error
    except ValueError as error:
        # A number of more digits than Python converts.
        raise _not_json("it holds a number of thousands of digits") from error
    if _SUSPECT.search(text):
        for pointer, fault in _unusable(value):
            raise Problem(
                400,
                "text_invalid",
                f"the body holds {fault} at {pointer}; remove it",
                errors=(Detail(pointer, f"holds {fault}"),),
            )
    return value


def _refuse_constant(name: str) -> Any:
    raise _not_json(f"{name} is not a number of JSON")


def _not_json(reason: str) -> Problem:
    detail = f"the body is not valid JSON: {reason}"
    return Problem(400, "invalid_json", detail, errors=(Detail("#", reason),))


def _unusable(value: Any) -> Iterator[tuple[str, str]]:
    """Yield pointers to the strings and numbers of a JSON value that cannot be stored, and what each is."""
    # A list of what is left, because the value may be nested as deeply as the parser allows.
    left: list[tuple[str, Any]] = [("#", value)]
    while left:
        pointer, part = left.pop()
        if isinstance(part, dict):
            if not all(map(storable, part)):
                yield pointer, "a name with a NUL or half of a surrogate pair"
                continue
            left += [(f"{pointer}/{_escaped(name)}", each) for name, each in part.items()]
        elif isinstance(part, list):
            left += [(f"{pointer}/{place}", each) for place, each in enumerate(part)]
        elif isinstance(part, str) and not storable(part):
            yield pointer, "a NUL or half of a surrogate pair"
        elif isinstance(part, int) and abs(part) > MAX_INTEGER:
            yield pointer, "an integer beyond 64 bits"
        elif isinstance(part, float) and not math.isfinite(part):
            yield pointer, "a number beyond 64 bits"


def _escaped(name: str) -> str:
    return name.replace("~", "~0").replace("/", "~1")


def media_type(text: str) -> str | None:
    """Return a media type as a Content-Type header may have it (RFC 9110, 8.3.1); None if it is not one.

    Without any text it is that of bytes of which nothing is known.
    """
    given = text.strip(" \t") or OCTETS
    return given if len(given) <= MAX_MEDIA_TYPE and _MEDIA_TYPE.fullmatch(given) else None


def refuse_form(content_type: str) -> None:
    """Refuse the body of a form with `unsupported_media_type` (415): its bytes are not those of the file."""
    if content_type.partition("/")[0].strip().lower() == "multipart":
        raise unsupported(
            f"the body has the Content-Type {content_type[:60]!r}, and a form is not read; send the bytes of "
            "the file as the body: curl -T FILE (or --data-binary @FILE), not -F",
            "Content-Type",
        )


def unsupported(detail: str, header: str) -> Problem:
    """Return the problem of a body of another kind than the one that is read; `header` says which it is."""
    errors = (Detail(f"#/header/{header}", detail),)
    return Problem(415, "unsupported_media_type", detail, errors=errors)
