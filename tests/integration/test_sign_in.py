"""Sign-in of people at a real OpenID Connect provider, and by the header of a proxy; with the real server."""

import base64
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, quote, urlsplit

import httpx2
import pytest
from support.live_server import LiveServer
from support.oidc_provider import CLIENT_ID, CLIENT_SECRET, Running, running

pytestmark = [pytest.mark.slow]
ANNA = {"sub": "a-1", "name": "Anna", "email": "anna@example.com", "email_verified": True}
COOKIE = "lambent_session"


@pytest.fixture(scope="module")
def provider() -> Iterator[Running]:
    with running() as provider:
        yield provider


@pytest.fixture(scope="module")
def server(provider: Running, tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveServer]:
    folder = tmp_path_factory.mktemp("oidc")
    secret = folder / "client.secret"
    secret.write_text(CLIENT_SECRET + "\n")
    settings = {
        "oidc_issuer": provider.issuer,
        "oidc_client_id": CLIENT_ID,
        "oidc_client_secret_file": str(secret),
        "oidc_organisation_claim": "groups",
        "oidc_role_claim": "role",
        "oidc_roles": {"boss": "admin"},
        "login_create": "claimed",
        "login_role": "viewer",
    }
    with LiveServer(folder / "data", **settings) as server:
        admin(server, "org", "create", "studio")
        yield server


def admin(server: LiveServer, *arguments: str) -> str:
    """Run a command of the operator beside the server."""
    command = [sys.executable, "-m", "lambent", "admin", *arguments, "--data", str(server.data)]
    return subprocess.run(command, check=True, capture_output=True, text=True, env=os.environ).stdout


class Browser(httpx2.Client):
    """Follows redirects by hand, as tests look at each."""

    def __init__(self, server: LiveServer) -> None:
        super().__init__(base_url=server.url, verify=False, headers={"x-lambent-csrf": "1"})

    def begin(self, query: str = "") -> str:
        """Return the address at the provider."""
        answer = self.get(f"/v1/sign-in{query}")
        assert answer.status_code == 303, answer.text
        return str(answer.headers["location"])

    def come_back(self, address: str) -> str:
        """Sign in at the provider and return the address of the callback."""
        answer = httpx2.get(address, verify=False)
        assert answer.status_code == 302, answer.text
        return str(answer.headers["location"])

    def sign_in(self, query: str = "") -> httpx2.Response:
        """Return the answer to the callback of a whole sign-in."""
        answer = self.get(self.come_back(self.begin(query)))
        assert answer.status_code == 303, answer.text
        return answer

    def me(self) -> dict[str, Any] | None:
        """Return who has signed in; None if nobody has."""
        answer = self.get("/v1/me")
        assert answer.status_code in (200, 401)
        return answer.json() if answer.status_code == 200 else None


@pytest.fixture
def browser(server: LiveServer) -> Iterator[Browser]:
    with Browser(server) as browser:
        yield browser


def actions(server: LiveServer, org: str) -> list[tuple[str, str]]:
    lines = admin(server, "audit", "export", "--org", org).splitlines()
    return [(entry["action"], entry["outcome"]) for entry in map(json.loads, lines)]


def test_somebody_who_is_claimed_to_belong_here_signs_in(
    server: LiveServer, provider: Running, browser: Browser
):
    assert browser.get("/v1/version").json()["sign_in_url"] == "/v1/sign-in"
    provider.control(person={**ANNA, "groups": ["studio", "elsewhere"], "role": ["boss"]})
    answer = browser.sign_in("?return_to=/viewer.html%23x")
    assert answer.headers["location"] == "/viewer.html#x"
    cookies = answer.headers.get_list("set-cookie")
    (session,) = [each for each in cookies if each.startswith(COOKIE) and "Max-Age=0" not in each]
    assert {"HttpOnly", "SameSite=strict"} <= {part.strip() for part in session.split(";")}
    me = browser.me()
    assert me is not None
    assert (me["name"], me["organisation"], me["kind"]) == ("Anna", "studio", "user")
    assert me["scopes"] == ["admin", "read", "render", "submit"]
    assert ("sign_in", "done") in actions(server, "studio")
    # What is claimed at the next sign-in holds from then on.
    provider.control(person={**ANNA, "groups": ["studio:viewer", "default"]})
    browser.sign_in()
    roles = {each["id"]: each["role"] for each in browser.me()["organisations"]}
    assert roles == {"studio": "viewer", "default": "viewer"}
    assert browser.post("/v1/logout").status_code == 204
    assert browser.me() is None


def test_who_is_claimed_to_belong_nowhere_is_refused(server: LiveServer, provider: Running, browser: Browser):
    provider.control(person={"sub": "b-2", "name": "Bob", "groups": ["elsewhere"]})
    assert browser.sign_in().headers["location"] == "/#sign-in=sign_in_refused"
    assert browser.me() is None
    assert actions(server, "-")[-1] == ("sign_in", "sign_in_refused")
    assert "Bob" not in admin(server, "user", "list")


def test_who_is_claimed_to_have_left_is_out_everywhere(
    provider: Running, server: LiveServer, browser: Browser
):
    person = {"sub": "c-3", "name": "Cleo", "groups": ["studio"]}
    provider.control(person=person)
    browser.sign_in()
    with Browser(server) as another:
        provider.control(person={**person, "groups": []})
        assert another.sign_in().headers["location"] == "/#sign-in=sign_in_refused"
    assert browser.me() is None


def test_a_user_added_by_address_is_bound_at_the_first_sign_in(
    provider: Running, server: LiveServer, browser: Browser
):
    admin(server, "user", "add", "dora@example.com", "--org", "studio", "--role", "editor")
    dora = {"sub": "d-4", "name": "Dora", "email": "Dora@example.com", "email_verified": False}
    provider.control(person=dora)
    assert browser.sign_in().headers["location"] == "/#sign-in=sign_in_refused", "the address is not verified"
    provider.control(person={**dora, "email_verified": True})
    browser.sign_in()
    assert "submit" in browser.me()["scopes"]
    # Someone else, who has been given the address later.
    provider.control(person={**dora, "sub": "e-5", "email_verified": True})
    with Browser(server) as another:
        assert another.sign_in().headers["location"] == "/#sign-in=sign_in_refused"


FAULTS = {
    "another nonce": {"claims": {"nonce": "x" * 43}},
    "no nonce": {"claims": {"nonce": None}},
    "another audience": {"claims": {"aud": "another"}},
    "several audiences, for another": {"claims": {"aud": [CLIENT_ID, "another"], "azp": "another"}},
    "no audience": {"claims": {"aud": None}},
    "another issuer": {"claims": {"iss": "https://id.example"}},
    "expired": {"claims": {"exp": 1_700_000_000}},
    "no end": {"claims": {"exp": None}},
    "from the future": {"claims": {"nbf": 4_000_000_000}},
    "no subject": {"claims": {"sub": None}},
    "a subject that is not text": {"claims": {"sub": "fay\0"}},
    "an address that is not text": {"claims": {"email": "fay\0@x.example", "email_verified": True}},
    "another key of the same name": {"key": "foreign"},
    "no signature": {"key": "none"},
    "signed with the client's secret": {"key": "secret"},
    "another access token": {"claims": {"at_hash": "AAAAAAAAAAAAAAAAAAAAAA"}},
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_token_that_is_not_for_this_sign_in_is_refused(provider: Running, browser: Browser, fault: str):
    provider.control(person={**ANNA, "groups": ["studio"]}, faults=FAULTS[fault])
    assert browser.sign_in().headers["location"] == "/#sign-in=sign_in_failed"
    assert browser.me() is None
    assert COOKIE not in browser.cookies


@pytest.mark.parametrize("kind", ["RSA", "EC"])
def test_new_keys_of_the_provider_are_fetched_when_they_are_needed(
    provider: Running, browser: Browser, kind: str
):
    provider.control(person={**ANNA, "groups": ["studio"]})
    browser.sign_in()
    assert browser.me() is not None
    before = provider.used().count("/jwks")
    time.sleep(5.1)
    provider.control(rotate=kind)
    browser.cookies.clear()
    browser.sign_in()
    assert browser.me() is not None
    assert provider.used().count("/jwks") == before + 1


def test_a_callback_works_once_and_only_in_the_browser_that_began(
    provider: Running, server: LiveServer, browser: Browser
):
    provider.control(person={**ANNA, "groups": ["studio"]})
    callback = browser.come_back(browser.begin())
    with Browser(server) as thief:
        assert thief.get(callback).headers["location"] == "/#sign-in=sign_in_failed"
        assert thief.me() is None
        # Not even in a browser that has begun another sign-in.
        thief.begin()
        assert thief.get(callback).headers["location"] == "/#sign-in=sign_in_failed"
    assert browser.get(callback).headers["location"] == "/"
    assert browser.me() is not None
    with Browser(server) as another:
        another.cookies = browser.cookies
        assert another.get(callback).headers["location"] == "/#sign-in=sign_in_failed"


def test_the_request_has_state_nonce_and_a_hashed_verifier(browser: Browser, server: LiveServer):
    query = parse_qs(urlsplit(browser.begin()).query)
    assert query["redirect_uri"] == [f"{server.url}/v1/sign-in/callback"]
    for name in ("state", "nonce", "code_challenge"):
        assert len(base64.urlsafe_b64decode(query[name][0] + "=")) == 32
    assert len({query[name][0] for name in ("state", "nonce", "code_challenge")}) == 3


@pytest.mark.parametrize("target", ["https://evil.example", "//evil.example", "/\\evil.example", "x", "/a\n"])
def test_nobody_is_sent_elsewhere_after_the_sign_in(provider: Running, browser: Browser, target: str):
    provider.control(person={**ANNA, "groups": ["studio"]})
    assert browser.sign_in(f"?return_to={quote(target, safe='')}").headers["location"] == "/"


def test_an_answer_of_another_provider_or_a_refusal_fails(provider: Running, browser: Browser):
    provider.control(person={**ANNA, "groups": ["studio"]})
    callback = browser.come_back(browser.begin())
    mixed = callback.replace("iss=http", "iss=https")
    assert mixed != callback
    assert browser.get(mixed).headers["location"] == "/#sign-in=sign_in_failed"
    nameless = browser.come_back(browser.begin()).partition("&iss=")[0]
    assert browser.get(nameless).headers["location"] == "/#sign-in=sign_in_failed"
    state = parse_qs(urlsplit(browser.begin()).query)["state"][0]
    refused = browser.get(f"/v1/sign-in/callback?error=access_denied&state={state}")
    assert refused.headers["location"] == "/#sign-in=sign_in_failed"


def test_a_write_of_a_user_needs_the_header_against_other_sites(provider: Running, browser: Browser):
    provider.control(person={**ANNA, "groups": ["studio"], "role": "boss"})
    browser.sign_in()
    del browser.headers["x-lambent-csrf"]
    answer = browser.post("/v1/scenes", json={"name": "s"})
    assert (answer.status_code, answer.json()["code"]) == (403, "csrf")


SECRET = "of the proxy of these tests"
PROXIED = {"x-forwarded-email": "fay@example.com", "x-lambent-login-secret": SECRET}


def proxied(folder: Path, trusted: str, **settings: Any) -> LiveServer:
    (folder / "login.secret").write_text(SECRET)
    return LiveServer(
        folder / "data",
        login_header="X-Forwarded-Email",
        login_secret_file=str(folder / "login.secret"),
        trusted_proxies=trusted,
        login_create="everybody",
        login_role="editor",
        **settings,
    )


def test_a_trusted_proxy_names_who_has_signed_in(tmp_path: Path):
    with proxied(tmp_path, "127.0.0.1") as server, Browser(server) as browser:
        assert browser.get("/v1/sign-in").status_code == 404, "nobody is named"
        without = {"x-forwarded-email": "fay@example.com"}
        assert browser.get("/v1/sign-in", headers=without).status_code == 404, "any process has this address"
        twice = [*PROXIED.items(), ("x-forwarded-email", "root@example.com")]
        assert browser.get("/v1/sign-in", headers=twice).status_code == 404, "one of the two is a lie"
        answer = browser.get("/v1/sign-in", headers=PROXIED)
        assert answer.headers["location"] == "/"
        assert browser.me() is None, "the session is valid only while the proxy names its user"
        browser.headers |= PROXIED
        me = browser.me()
        assert (me["name"], me["organisation"]) == ("fay@example.com", "default")
        assert me["scopes"] == ["read", "render", "submit"]
        assert browser.post("/v1/scenes", json={"name": "s"}).status_code == 201
        browser.headers["x-forwarded-email"] = "gus@example.com"
        assert browser.me() is None
        assert ("sign_in", "done") in actions(server, "default")


def test_a_trusted_proxy_names_organisations_or_says_that_there_are_none(tmp_path: Path):
    with proxied(tmp_path, "127.0.0.1", login_organisations_header="X-Forwarded-Groups") as server:
        admin(server, "org", "create", "studio")
        many = ",".join([*(f"team-{number}" for number in range(50)), "studio:admin", "studio:viewer"])
        with Browser(server) as browser:
            browser.headers |= PROXIED
            answer = browser.get("/v1/sign-in", headers={"x-forwarded-groups": many})
            assert answer.headers["location"] == "/"
            me = browser.me()
            assert (me["organisation"], me["organisations"][0]["role"]) == ("studio", "admin")
            for headers in ({"x-forwarded-groups": ""}, {}):
                answer = browser.get("/v1/sign-in", headers=headers)
                assert answer.headers["location"] == "/#sign-in=sign_in_refused"
                assert browser.me() is None, "who has lost the last group is out"
        with Browser(server) as stranger:
            answer = stranger.get("/v1/sign-in", headers={**PROXIED, "x-forwarded-email": "gus@example.com"})
            assert answer.headers["location"] == "/#sign-in=sign_in_refused"


def test_nobody_else_names_anybody(tmp_path: Path):
    # The proxy is elsewhere: this client is not trusted, whatever it says about itself.
    with proxied(tmp_path, "10.1.2.3") as server, Browser(server) as browser:
        for headers in (PROXIED, {**PROXIED, "x-forwarded-for": "10.1.2.3"}):
            assert browser.get("/v1/sign-in", headers=headers).status_code == 404
            assert browser.get("/v1/me", headers=headers).status_code == 401
