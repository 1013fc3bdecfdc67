"""Whom a trusted proxy names: no part of a name is a person, and no part of a list an organisation."""

import asyncio
from pathlib import Path
from typing import Any

import pytest
from lambent_server.core.settings import ServeError, Settings
from lambent_server.http.login_header import LOGIN_NAME, LOGIN_ORGANISATIONS, LoginHeader, login_secret
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
    # What it begins with, or how it continues, is in no log.
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


SECRET = "a secret of more than twenty characters"
LOCAL = ("127.0.0.1", "127.0.0.0/8", "0.0.0.0/0", "10.0.0.2,::1", "::/0", "::ffff:127.0.0.1")


def with_secret(folder: Path, text: str = SECRET) -> dict[str, Any]:
    """Return the setting for a file with this secret."""
    path = folder / "login.secret"
    path.write_text(text + "\n")
    return {"login_secret_file": path}


def test_only_who_knows_the_secret_names_anybody(tmp_path: Path):
    given = {**with_secret(tmp_path), "trusted_proxies": "127.0.0.1"}
    named = ("X-Name", "fay")

    def state(*headers: tuple[str, str], peer: str = "127.0.0.1") -> dict[str, str]:
        return state_of(tmp_path, named, *headers, peer=peer, **given)

    right, wrong = ("X-Lambent-Login-Secret", SECRET), ("X-Lambent-Login-Secret", SECRET + "x")
    assert state(right) == {LOGIN_NAME: "fay"}
    with capture_logs() as logs:
        for headers in ((), (wrong,), (right, wrong), (right, right), (("X-Lambent-Login-Secret", ""),)):
            assert state(*headers) == {}
    assert {each["event"] for each in logs} == {"login_secret_wrong"}
    assert SECRET not in str(logs)
    assert state(right, peer="10.0.0.9") == {}


@pytest.mark.parametrize("trusted", LOCAL)
def test_a_proxy_of_the_loopback_needs_a_secret(tmp_path: Path, trusted: str):
    settings = Settings(data=tmp_path, login_header="X-Name", trusted_proxies=trusted)
    with pytest.raises(ServeError, match=r"^serve\.login_secret_missing: .*LAMBENT_LOGIN_SECRET_FILE"):
        login_secret(settings)
    assert login_secret(settings.model_copy(update=with_secret(tmp_path))) == SECRET.encode()


def test_a_proxy_of_another_machine_and_one_that_names_nobody_need_none(tmp_path: Path):
    for given in (
        {"login_header": "X-Name", "trusted_proxies": "10.0.0.2,fd00::/8"},
        {"trusted_proxies": "127.0.0.1"},
    ):
        assert login_secret(Settings(data=tmp_path, **given)) is None


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        *(
            (text, "at least 20")
            for text in ("", "short", "a tab \t in a secret of twenty", "two lines\n" * 3)
        ),
        (None, "nothing cannot be read"),
    ],
)
def test_a_file_without_a_secret_is_refused(tmp_path: Path, text: str | None, reason: str):
    given = {"login_secret_file": tmp_path / "nothing"} if text is None else with_secret(tmp_path, text)
    with pytest.raises(ServeError, match=rf"^serve\.login_secret_invalid: .*{reason}"):
        login_secret(Settings(data=tmp_path, **given))
