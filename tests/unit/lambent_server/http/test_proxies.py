"""Headers of proxies about their clients, and the proxies that are trusted."""

from pathlib import Path
from typing import Any

import anyio
import pytest
from lambent_server.http.proxies import Proxies, address_of
from starlette.testclient import TestClient
from support.api import KEY, expect, opened


def seen(peer: str, *headers: tuple[str, str], trusted: tuple[str, ...] = ("10.0.0.0/8", "::1")) -> Any:
    """Return the client's address and the scheme as the application sees them."""
    scope: dict[str, Any] = {"type": "http", "scheme": "http", "client": (peer, 1)}
    scope["headers"] = [(name.encode(), value.encode()) for name, value in headers]

    async def app(scope: Any, receive: Any, send: Any) -> None:
        pass

    async def ask() -> None:
        await Proxies(app, trusted)(scope, None, None)  # type: ignore[arg-type]

    anyio.run(ask)
    return scope["client"][0], scope["scheme"]


FOR, PROTO = "x-forwarded-for", "x-forwarded-proto"


def test_the_scheme_is_believed_with_and_without_an_address():
    assert seen("10.0.0.1", (PROTO, "https")) == ("10.0.0.1", "https")
    assert seen("10.0.0.1", (PROTO, "HTTPS"), (FOR, "9.9.9.9")) == ("9.9.9.9", "https")
    assert seen("10.0.0.1", (PROTO, "https, http")) == ("10.0.0.1", "https")
    assert seen("10.0.0.1", (PROTO, "https"), (PROTO, "http")) == ("10.0.0.1", "https")
    assert seen("10.0.0.1", (PROTO, "gopher")) == ("10.0.0.1", "http")


def test_nobody_else_is_believed():
    for peer in ("9.9.9.9", "11.0.0.1", "", "unix:"):
        assert seen(peer, (PROTO, "https"), (FOR, "1.2.3.4")) == (peer, "http")


@pytest.mark.parametrize(
    ("given", "client"),
    [
        ("9.9.9.9", "9.9.9.9"),
        # The client wrote the first one.
        ("1.1.1.1, 9.9.9.9, 10.0.0.2", "9.9.9.9"),
        ("9.9.9.9:1234", "9.9.9.9"),
        ("[2001:db8::1]:80", "2001:db8::1"),
        ("10.0.0.3, 10.0.0.2", "10.0.0.3"),
        # Behind what is not an address anyone may have written the rest.
        ("9.9.9.9, unknown", "10.0.0.1"),
        ("", "10.0.0.1"),
    ],
)
def test_the_client_is_the_last_address_that_is_no_proxy(given: str, client: str):
    assert seen("10.0.0.1", (FOR, given))[0] == client


def test_a_proxy_of_the_older_family_is_known_on_a_socket_for_both():
    assert seen("::ffff:10.0.0.1", (PROTO, "https"))[1] == "https"
    assert str(address_of("fe80::1%eth0")) == "fe80::1"


def test_links_and_cookies_behind_a_proxy_with_tls_are_https(tmp_path: Path):
    with opened(tmp_path / "data") as api:
        headers = {"Authorization": f"Bearer {KEY}", PROTO: "https"}
        for trusted, scheme in (("127.0.0.1", "https"), ("10.0.0.1", "http")):
            gate = Proxies(api.client.app, [trusted])
            client = TestClient(gate, base_url="http://localhost", headers=headers, client=("127.0.0.1", 5))
            link = expect(client.post("/v1/login-links"), 201)["url"]
            assert link.startswith(f"{scheme}://localhost/#code=")
            cookie = client.post("/v1/login", json={"code": link.rpartition("=")[2]}).headers["set-cookie"]
            assert ("Secure" in cookie) == (scheme == "https")
            moved = client.get("/v1/scenes/", follow_redirects=False)
            assert moved.headers["location"] == f"{scheme}://localhost/v1/scenes"
