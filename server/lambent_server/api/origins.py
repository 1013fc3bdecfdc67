"""Web origins that may show a shared bundle: scheme, host and port, as browsers write them (RFC 6454)."""

import re
from collections.abc import Iterable
from typing import Annotated

from pydantic import AfterValidator, WithJsonSchema

_LABEL = "[a-z0-9]([a-z0-9-]{0,61}[a-z0-9])?"
_PORT = "(6553[0-5]|655[0-2][0-9]|65[0-4][0-9]{2}|6[0-4][0-9]{3}|[1-5][0-9]{4}|[1-9][0-9]{0,3})"
PATTERN = rf"^https?://{_LABEL}(\.{_LABEL}){{0,20}}(:{_PORT})?$"
"""No wildcards, no paths, and nothing that would end a directive of a content security policy."""
MAX_LENGTH = 260
MAX_COUNT = 20
_DEFAULT_PORTS = {"http": ":80", "https": ":443"}


def origin(text: str) -> str:
    """Return an origin without its scheme's default port; raises ValueError where it is none."""
    if len(text) > MAX_LENGTH or not re.match(PATTERN, text) or text.endswith("\n"):
        raise ValueError(
            f"{text[:80]!r} is not an origin; write https://shop.example or http://localhost:8080, in lower "
            "case (xn--... for other letters), without a path, a slash at the end or a wildcard"
        )
    return text.removesuffix(_DEFAULT_PORTS[text.partition(":")[0]])


def joined(origins: Iterable[str]) -> str:
    """Return valid origins as one text, each of them once: the source list of `frame-ancestors`."""
    return " ".join(dict.fromkeys(origin(each) for each in origins))


Origin = Annotated[
    str,
    AfterValidator(origin),
    WithJsonSchema({"type": "string", "pattern": PATTERN, "maxLength": MAX_LENGTH}),
]
