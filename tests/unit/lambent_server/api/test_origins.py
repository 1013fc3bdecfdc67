"""Origins: what browsers write, and nothing that could change a policy."""

import re

import pytest
from lambent_server.api.origins import PATTERN, joined, origin


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("https://shop.example", "https://shop.example"),
        ("https://shop.example:443", "https://shop.example"),
        ("http://localhost:8080", "http://localhost:8080"),
        ("http://10.0.0.7:80", "http://10.0.0.7"),
        ("https://xn--bcher-kva.example:65535", "https://xn--bcher-kva.example:65535"),
        ("https://shop.example:80", "https://shop.example:80"),
    ],
)
def test_an_origin_is_as_browsers_write_it(text: str, expected: str):
    assert origin(text) == expected
    assert re.match(PATTERN, text)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "*",
        "null",
        "'self'",
        "https:",
        "https://",
        "https://*",
        "https://*.example",
        "https://shop.example/",
        "https://shop.example/path",
        "https://Shop.example",
        "https://bücher.example",
        "https://shop.example:0",
        "https://shop.example:65536",
        "https://user@shop.example",
        "https://shop.example https://evil.example",
        "https://shop.example; script-src *",
        "https://shop.example\n",
        "https://shop.example,https://evil.example",
        "https://shop..example",
        "https://-shop.example",
        "https://[::1]",
        "ftp://shop.example",
        "javascript://shop.example",
        f"https://{'a' * 64}.example",
        f"https://{'a.' * 140}example",
    ],
)
def test_what_is_no_origin_is_refused(text: str):
    with pytest.raises(ValueError, match="is not an origin"):
        origin(text)


def test_each_origin_is_there_once():
    given = ["https://a.example", "https://b.example", "https://a.example:443"]
    assert joined(given) == "https://a.example https://b.example"
    assert joined([]) == ""
