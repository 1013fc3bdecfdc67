"""The provider of the settings while it hangs, fails, or answers with too little."""

import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from anyio import to_thread
from joserfc import jwk
from lambent_server.accounts import oidc
from lambent_server.accounts.oidc import KEYS_AGAIN_S, Provider, SignInError
from lambent_server.core.settings import Settings
from support.api import Api, expect, opened

ISSUER = "https://id.example"
SETTINGS = {"oidc_issuer": ISSUER, "oidc_client_id": "lambent"}
DESCRIPTION = {
    "issuer": ISSUER,
    "authorization_endpoint": f"{ISSUER}/authorize",
    "token_endpoint": f"{ISSUER}/token",
    "jwks_uri": f"{ISSUER}/jwks",
}


class Wire:
    """The answers of a provider, and the number of requests for them."""

    def __init__(self) -> None:
        self.answer: Any = DESCRIPTION
        self.asked = 0
        self.at = 100.0

    def request(self, _provider: Provider, _method: str, _address: str, **_given: Any) -> Any:
        """Answer one request."""
        self.asked += 1
        if isinstance(self.answer, SignInError):
            raise self.answer
        return self.answer

    def monotonic(self) -> float:
        """Return the time."""
        return self.at


@pytest.fixture
def wire(monkeypatch: pytest.MonkeyPatch) -> Wire:
    wire = Wire()
    monkeypatch.setattr(Provider, "_request", lambda *given, **more: wire.request(*given, **more))
    monkeypatch.setattr(oidc.time, "monotonic", wire.monotonic)
    return wire


@pytest.fixture
def provider(tmp_path: Path) -> Provider:
    return Provider(Settings(data=tmp_path, **SETTINGS))


def test_a_provider_that_fails_is_left_alone_for_a_moment(wire: Wire, provider: Provider):
    wire.answer = SignInError("provider_unavailable", "it hangs")
    for _ in range(3):
        with pytest.raises(SignInError, match="it hangs") as failed:
            provider.description()
        assert failed.value.code == "provider_unavailable"
    assert wire.asked == 1
    wire.at += KEYS_AGAIN_S + 0.1
    wire.answer = DESCRIPTION
    assert provider.description().issuer == ISSUER
    # It is known from now on; and its keys fail on their own.
    wire.answer = SignInError("provider_unavailable", "no keys")
    for _ in range(3):
        with pytest.raises(SignInError, match="no keys"):
            provider._known_keys()
    assert wire.asked == 3
    assert provider.description().issuer == ISSUER


def test_who_knows_enough_waits_for_nobody_who_asks(
    wire: Wire, provider: Provider, monkeypatch: pytest.MonkeyPatch
):
    assert provider.description().issuer == ISSUER
    wire.answer = {"keys": [jwk.ECKey.generate_key("P-256").as_dict(private=False)]}
    keys = provider._known_keys()
    begun, end = threading.Event(), threading.Event()

    def hang(*_: Any, **__: Any) -> Any:
        begun.set()
        assert end.wait(60)
        return wire.answer

    monkeypatch.setattr(Provider, "_request", hang)
    wire.at += KEYS_AGAIN_S + 0.1
    with ThreadPoolExecutor(2) as pool:
        try:
            # A token of a key that is not known: perhaps the provider has a new one.
            asking = pool.submit(provider._known_keys, again=True)
            assert begun.wait(20)
            assert pool.submit(provider.description).result(timeout=20).issuer == ISSUER
            assert pool.submit(provider._known_keys).result(timeout=20) is keys
        finally:
            end.set()
        assert asking.result(timeout=20) is not keys


@pytest.mark.parametrize("keys", [{"keys": []}, {}, {"keys": [{"kty": "EC", "crv": "P-256"}]}])
def test_a_provider_without_a_key_is_left_alone_for_a_moment_too(
    wire: Wire, provider: Provider, keys: dict[str, Any]
):
    provider.description()
    wire.answer = keys
    for _ in range(3):
        with pytest.raises(SignInError, match="has no keys") as refused:
            provider._known_keys()
        assert refused.value.code == "provider_invalid"
    assert wire.asked == 2


def test_many_who_need_the_same_ask_once(wire: Wire, provider: Provider):
    with ThreadPoolExecutor(8) as pool:
        found = [each.result() for each in [pool.submit(provider.description) for _ in range(8)]]
    assert {each.issuer for each in found} == {ISSUER}
    assert wire.asked == 1


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"token_endpoint": None}, "does not describe itself"),
        ({"issuer": "https://other.example"}, "calls itself"),
        ({"jwks_uri": "http://id.example/jwks"}, "is not encrypted"),
    ],
)
def test_a_provider_that_describes_itself_badly_is_refused(
    wire: Wire, provider: Provider, change: dict[str, Any], words: str
):
    wire.answer = {**DESCRIPTION, **change}
    with pytest.raises(SignInError, match=words) as refused:
        provider.description()
    assert refused.value.code == "provider_invalid"


@pytest.mark.parametrize(
    ("promised", "iss", "accepted"),
    [
        (True, ISSUER, True),
        (True, None, False),
        (True, "https://other.example", False),
        (False, None, True),
        (False, "https://other.example", False),
    ],
)
def test_an_answer_names_its_issuer_if_the_provider_says_that_it_does(
    wire: Wire, provider: Provider, promised: bool, iss: str | None, accepted: bool
):
    wire.answer = {**DESCRIPTION, "authorization_response_iss_parameter_supported": promised}
    if accepted:
        provider.check_issuer(iss)
        return
    with pytest.raises(SignInError) as refused:
        provider.check_issuer(iss)
    assert refused.value.code == "provider_invalid"


@pytest.fixture
def api(tmp_path: Path) -> Iterator[Api]:
    with opened(tmp_path / "data", **SETTINGS) as api:
        yield api


def test_a_provider_that_hangs_holds_up_nobody_else(api: Api, monkeypatch: pytest.MonkeyPatch):
    begun, end = threading.Event(), threading.Event()

    def hang(*_: Any, **__: Any) -> Any:
        begun.set()
        end.wait(60)
        raise SignInError("provider_unavailable", "it hangs")

    async def leave_one_thread() -> None:
        to_thread.current_default_thread_limiter().total_tokens = 1

    monkeypatch.setattr(Provider, "_request", hang)
    portal = api.client.portal
    assert portal is not None
    portal.call(leave_one_thread)
    with ThreadPoolExecutor(2) as pool:
        try:
            stranger = pool.submit(api.client.get, "/v1/sign-in", follow_redirects=False)
            assert begun.wait(20)
            expect(pool.submit(api.client.get, "/v1/scenes").result(timeout=20), 200)
        finally:
            end.set()
        assert stranger.result(timeout=20).headers["location"] == "/#sign-in=sign_in_failed"
