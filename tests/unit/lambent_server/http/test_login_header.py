"""Whom a trusted proxy names: no part of a name is a person, and no part of a list an organisation."""

import asyncio
from pathlib import Path
from typing import Any

from lambent_server.http.login_header import LOGIN_NAME, LOGIN_ORGANISATIONS, LoginHeader
from lambent_server.settings import Settings
from structlog.testing import capture_logs


def state_of(
    folder: Path, *headers: tuple[str, str], peer: str = "10.0.0.1", **settings: Any
) -> dict[str, str]:
    """Return what the application learns about a request with these headers."""
    seen: dict[str, Any] = {}

    async def app(scope: Any, receive: Any, send: Any) -> None:
        seen.update(scope.get("state", {}))

    given = {
        "login_header": "X-Name",
        "login_organisations_header": "X-Groups",
        "trusted_proxies": "10.0.0.1",
    }
    raw = [(name.lower().encode(), value.encode("latin-1")) for name, value in headers]
    layer = LoginHeader(app, Settings(data=folder, **{**given, **settings}))
    asyncio.run(layer({"type": "http", "client": (peer, 1), "headers": raw}, None, None))
    return seen


def test_a_long_name_is_nobodys(tmp_path: Path):
    assert state_of(tmp_path, ("X-Name", "n" * 200)) == {LOGIN_NAME: "n" * 200}
    with capture_logs() as logs:
        assert LOGIN_NAME not in state_of(tmp_path, ("X-Name", "n" * 201))
    assert [(each["event"], each["log_level"]) for each in logs] == [("login_name_too_long", "warning")]
    # What it begins with, or how it goes on, is in no log.
    assert "nnn" not in str(logs)


def test_a_list_of_organisations_is_whole(tmp_path: Path):
    groups = ",".join(f"organisation-{number}:viewer" for number in range(100))
    found = state_of(tmp_path, ("X-Name", "fay"), ("X-Groups", groups))
    assert found == {LOGIN_NAME: "fay", LOGIN_ORGANISATIONS: groups}


def test_others_and_two_headers_name_nobody(tmp_path: Path):
    assert state_of(tmp_path, ("X-Name", "fay"), peer="10.0.0.2") == {}
    assert state_of(tmp_path, ("X-Name", "fay"), ("X-Name", "root")) == {}
    assert state_of(tmp_path, ("X-Name", "  ")) == {}
    assert state_of(tmp_path, ("X-Name", "fay"), peer="::ffff:10.0.0.1") == {LOGIN_NAME: "fay"}
