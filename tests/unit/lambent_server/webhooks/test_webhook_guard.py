"""Addresses of webhooks: none is inside, however the address is written or wrapped."""

import ipaddress
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from lambent_server.core.settings import Settings
from lambent_server.webhooks.guard import Guard, RefusedAddress, is_public
from pydantic import ValidationError

PLAIN = Guard()
ONLY_EXAMPLE = {"webhook_only_allowed": True, "webhook_allowed": "*.example.com"}
INSIDE = [
    "0.0.0.0",
    "10.1.2.3",
    "100.64.0.1",
    "100.100.100.200",
    "127.0.0.1",
    "127.255.255.254",
    "168.63.129.16",
    "169.254.169.254",
    "172.16.0.1",
    "172.31.255.255",
    "192.0.0.192",
    "192.0.2.1",
    "192.88.99.1",
    "192.168.1.1",
    "198.18.0.1",
    "203.0.113.7",
    "224.0.0.1",
    "224.0.1.1",
    "239.255.255.250",
    "240.0.0.1",
    "255.255.255.255",
    "::",
    "::1",
    "::127.0.0.1",
    "::ffff:127.0.0.1",
    "::ffff:8.8.8.8",
    "::ffff:0:127.0.0.1",
    "64:ff9b::127.0.0.1",
    "64:ff9b::8.8.8.8",
    "64:ff9b:1::a00:1",
    "100::1",
    "2001::1",
    "2001:0:4136:e378:8000:63bf:3fff:fdd2",
    "2001:db8::1",
    "2002:7f00:1::1",
    "2002:808:808::1",
    "3fff::1",
    "5f00::1",
    "fc00::1",
    "fd00:ec2::254",
    "fe80::1",
    "fe80::1%eth0",
    "2606:4700::1%eth0",
    "fec0::1",
    "ff02::1",
]
OUTSIDE = ["1.1.1.1", "8.8.8.8", "93.184.215.14", "2606:4700:4700::1111", "2a00:1450:4001:81b::200e"]
MALFORMED = [
    "",
    "example.com/x",
    "//example.com/x",
    "https:/example.com",
    "https://",
    "https:///x",
    "ftp://example.com/",
    "file:///etc/passwd",
    "gopher://example.com/",
    "javascript:alert(1)",
    " https://example.com/",
    "https://example.com/\n",
    "https://example.com/a b",
    "https://example.com/\r\nx: y",
    "https://example.com/#part",
    "https://example.com\\@127.0.0.1/",
    "https://user@example.com/",
    "https://user:word@example.com/",
    "https://example.com@127.0.0.1/",
    "https://example.com:443@127.0.0.1/",
    "https://2130706433/",
    "https://0177.0.0.1/",
    "https://017700000001/",
    "https://0x7f.0.0.1/",
    "https://0x7f000001/",
    "https://0x/",
    "https://127.1/",
    "https://127.0.1/",
    "https://127.0.0.1./",
    "https://127.0.0.01/",
    "https://1.2.3.4.5/",
    "https://256.1.1.1/",
    "https://example.com./",
    "https://.example.com/",
    "https://example..com/",
    "https://-x.com/",
    "https://127。0。0。1/",
    "https://127．0．0．1/",
    "https://①②⑦.0.0.1/",
    "https://bücher.example/",
    "https://ⓔxample.com/",
    "https://exam%70le.com/",
    "https://127.0.0.1%2f@example.com/",
    "https://[fe80::1%25eth0]/",
    "https://[fe80::1%eth0]/",
    "https://[::1/",
    "https://::1/",
    "https://[127.0.0.1]/",
    "https://[]/",
    "https://[::g]/",
    "https://example.com:/",
    "https://example.com:+443/",
    "https://example.com:٤٤٣/",
    "https://example.com?x=1",
    f"https://example.com/{'a' * 2000}",
    f"https://{'a' * 64}.com/",
]


def refusal(guard: Guard, url: str) -> str:
    """Return the code with which a URL is refused."""
    with pytest.raises(RefusedAddress) as caught:
        guard.parse(url)
    return caught.value.code


@pytest.mark.parametrize("url", MALFORMED)
def test_only_plain_urls_are_read(url: str):
    assert refusal(PLAIN, url) == "url_invalid"


@pytest.mark.parametrize("text", INSIDE)
def test_addresses_that_are_not_public_are_refused_as_host_and_as_answer_of_a_name(text: str):
    host = f"[{text}]" if ":" in text else text
    assert refusal(PLAIN, f"https://{host}/") == ("url_invalid" if "%" in text else "address_refused")
    target = PLAIN.parse("https://example.com/")
    for answer in ([text], ["8.8.8.8", text], [text, "8.8.8.8"]):
        with pytest.raises(RefusedAddress) as caught:
            PLAIN.permitted(target, answer)
        assert caught.value.code == "address_refused"
        assert text not in str(caught.value)


@pytest.mark.parametrize("text", OUTSIDE)
def test_public_addresses_are_allowed(text: str):
    host = f"[{text}]" if ":" in text else text
    target = PLAIN.parse(f"https://{host}/x?y=1")
    assert (target.host, target.url_at(text)) == (text, f"https://{host}:443/x?y=1")
    assert PLAIN.permitted(PLAIN.parse("https://example.com"), [text]) == [text]


@given(st.integers(0, 2**32 - 1))
@example(0x7F000001)
def test_no_wrapping_makes_an_ipv4_address_public(number: int):
    bare = int(ipaddress.IPv4Address(number))
    for prefix in (0, 0xFFFF << 32, 0xFFFF << 48, 0x0064FF9B << 96, 0x0064FF9B0001 << 80):
        assert not is_public(ipaddress.IPv6Address(prefix | bare))
    assert not is_public(ipaddress.IPv6Address((0x2002 << 112) | (bare << 80) | 1))
    assert not is_public(ipaddress.IPv6Address((0x20010000 << 96) | (bare << 32) | (bare ^ 0xFFFFFFFF)))


@given(st.ip_addresses(v=4))
def test_a_public_ipv4_address_is_global_and_of_one_machine(address: ipaddress.IPv4Address):
    if is_public(address):
        assert address.is_global
        special = (address.is_private, address.is_multicast, address.is_loopback, address.is_link_local)
        assert not any(special)


@given(st.text(max_size=60))
def test_what_is_accepted_is_what_is_connected_to(text: str):
    try:
        target = PLAIN.parse(f"https://{text}")
    except RefusedAddress:
        return
    given = f"https://{text}".lower()
    assert given.isascii()
    assert "@" not in given.split("/")[2]
    assert given.startswith((f"https://{target.host}", f"https://[{target.host}"[:9]))
    assert target.url_at("8.8.8.8").startswith("https://8.8.8.8:443/")


@pytest.mark.parametrize(
    ("settings", "url", "code"),
    [
        ({}, "http://example.com/", "scheme_refused"),
        ({}, "https://example.com:22/", "port_refused"),
        ({}, "https://example.com:8443/", None),
        ({"webhook_allow_http": True}, "http://example.com/", "port_refused"),
        ({"webhook_allow_http": True, "webhook_ports": "80,443"}, "http://example.com/", None),
        ({"webhook_allowed": "10.0.0.0/8"}, "https://10.9.9.9/", None),
        ({"webhook_allowed": "10.0.0.0/8"}, "https://11.9.9.9/", None),
        ({"webhook_allowed": "10.0.0.0/8"}, "https://192.168.0.1/", "address_refused"),
        ({"webhook_allowed": "10.0.0.0/8"}, "https://[::ffff:10.0.0.1]/", "address_refused"),
        ({"webhook_allowed": "fd00::/8"}, "https://[fd00::1]/", None),
        ({"webhook_only_allowed": True}, "https://example.com/", "address_refused"),
        ({"webhook_only_allowed": True}, "https://8.8.8.8/", "address_refused"),
        ({"webhook_only_allowed": True, "webhook_allowed": "*.example.com"}, "https://a.Example.com/", None),
        (
            {"webhook_only_allowed": True, "webhook_allowed": "*.example.com"},
            "https://a.b.example.com/",
            None,
        ),
        (ONLY_EXAMPLE, "https://example.com/", "address_refused"),
        (ONLY_EXAMPLE, "https://badexample.com/", "address_refused"),
    ],
)
def test_settings_say_what_else_is_allowed(
    monkeypatch: pytest.MonkeyPatch, settings: dict[str, Any], url: str, code: str | None
):
    for name, value in settings.items():
        monkeypatch.setenv(f"LAMBENT_{name.upper()}", str(value))
    guard = Guard.of(Settings())
    if code is None:
        guard.parse(url)
    else:
        assert refusal(guard, url) == code


def test_a_listed_name_may_lead_inside_and_no_other_name():
    guard = Guard(hosts=frozenset({"render.studio"}))
    assert guard.permitted(guard.parse("https://render.studio/"), ["10.0.0.7"]) == ["10.0.0.7"]
    with pytest.raises(RefusedAddress):
        guard.permitted(guard.parse("https://render.studio.example/"), ["10.0.0.7"])


def test_a_name_without_addresses_is_unknown():
    with pytest.raises(RefusedAddress) as caught:
        PLAIN.permitted(PLAIN.parse("https://example.com/"), [])
    assert caught.value.code == "name_unknown"


@pytest.mark.parametrize("entry", ["10.0.0.1/8", "fd00::/200", "*", "a b", "http://x"])
def test_a_list_with_something_else_in_it_is_no_setting(monkeypatch: pytest.MonkeyPatch, entry: str):
    monkeypatch.setenv("LAMBENT_WEBHOOK_ALLOWED", entry)
    with pytest.raises(ValidationError):
        Settings()
