"""Sign-in at an OpenID Connect provider: authorization code with PKCE, state and nonce.

The provider's description and its keys are asked for when they are needed, and again when a token is signed
with a key that is not known: providers replace their keys.
"""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar
from urllib.parse import urlencode, urlsplit

import httpx2
from pydantic import BaseModel, ConfigDict, ValidationError

from lambent_server.core.settings import Settings

TIMEOUT_S = 10.0
DESCRIPTION_S = 3600.0
"""Time for which the description and keys of a provider are used."""
KEYS_AGAIN_S = 5.0
"""Shortest time between two requests for its keys, and after a request that failed."""
THREADS = 4
"""In which sign-ins wait for the provider; all others of the server stay free."""
LEEWAY_S = 60
"""By how much its clock may differ."""
# Signed by the provider with a key that nobody else has: not "none", nor one that the client knows.
ALGORITHMS = (
    "RS256",
    "RS384",
    "RS512",
    "PS256",
    "PS384",
    "PS512",
    "ES256",
    "ES384",
    "ES512",
    "EdDSA",
    "Ed25519",
)
T = TypeVar("T")
_LOOPBACK = frozenset({"localhost", "127.0.0.1", "::1"})


class SignInError(Exception):
    """A sign-in that fails; the code is stable, the message is for the log."""

    def __init__(self, code: str, message: str) -> None:
        super().__init__(message)
        self.code = code


class Description(BaseModel):
    """What a provider says about itself (OpenID Connect Discovery)."""

    model_config = ConfigDict(extra="ignore")

    issuer: str
    authorization_endpoint: str
    token_endpoint: str
    jwks_uri: str
    token_endpoint_auth_methods_supported: list[str] = ["client_secret_basic"]
    authorization_response_iss_parameter_supported: bool = False


@dataclass(frozen=True, kw_only=True, slots=True)
class Tokens:
    """What the provider gives for a code."""

    id_token: str
    access_token: str


class Provider:
    """The provider of the settings. Safe for use by several threads."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        # For requests of the two below; what is known is read without it, also while it is being read again.
        self._asking = threading.Lock()
        self._description: tuple[Description, float] | None = None
        self._keys: tuple[Any, float] | None = None
        # What failed last, and until when nobody tries again.
        self._failure: tuple[SignInError, float] | None = None

    def description(self) -> Description:
        """Return what the provider says about itself."""
        known = self._description
        if known is None or known[1] < time.monotonic():
            with self._asking:
                known = self._description
                if known is None or known[1] < time.monotonic():
                    description = self._once_in_a_while(self._read_description)
                    known = self._description = description, time.monotonic() + DESCRIPTION_S
        return known[0]

    def _once_in_a_while(self, ask: Callable[[], T]) -> T:
        """Return what the provider says; soon after a failure, raise that again instead of asking.

        Whoever calls this holds the lock, and others who need an answer wait for it: of those who wait for a
        provider that hangs only the first waits as long as it does.
        """
        if self._failure is not None and time.monotonic() < self._failure[1]:
            raise SignInError(self._failure[0].code, f"{self._failure[0]} (a moment ago)")
        try:
            return ask()
        except SignInError as error:
            self._failure = error, time.monotonic() + KEYS_AGAIN_S
            raise

    def check_issuer(self, iss: str | None) -> None:
        """Raise SignInError unless an answer, which may name its issuer, is of this provider (RFC 9207)."""
        issuer = self._settings.oidc_issuer
        if iss is None and self.description().authorization_response_iss_parameter_supported:
            raise SignInError("provider_invalid", f"the answer does not say that it is of {issuer}")
        if iss is not None and iss != issuer:
            raise SignInError("provider_invalid", f"the answer is of {iss[:100]!r}")

    def _read_description(self) -> Description:
        issuer = self._settings.oidc_issuer or ""
        document = self._get(f"{issuer.rstrip('/')}/.well-known/openid-configuration")
        try:
            description = Description.model_validate(document)
        except ValidationError as error:
            raise SignInError("provider_invalid", f"{issuer} does not describe itself: {error}") from error
        if description.issuer != issuer:
            raise SignInError("provider_invalid", f"{issuer} calls itself {description.issuer!r}")
        for name in ("authorization_endpoint", "token_endpoint", "jwks_uri"):
            _require_safe(getattr(description, name))
        return description

    def address(self, redirect_uri: str, state: str, nonce: str, verifier: str) -> str:
        """Return where a browser goes to sign in."""
        from authlib.oauth2.rfc7636 import create_s256_code_challenge

        query = {
            "response_type": "code",
            "client_id": self._settings.oidc_client_id or "",
            "redirect_uri": redirect_uri,
            "scope": self._settings.oidc_scopes,
            "state": state,
            "nonce": nonce,
            "code_challenge": create_s256_code_challenge(verifier),
            "code_challenge_method": "S256",
        }
        endpoint = self.description().authorization_endpoint
        return f"{endpoint}{'&' if '?' in endpoint else '?'}{urlencode(query)}"

    def exchange(self, code: str, verifier: str, redirect_uri: str) -> Tokens:
        """Return the tokens for the code that a browser has brought."""
        description, client_id = self.description(), self._settings.oidc_client_id or ""
        form = {
            "grant_type": "authorization_code",
            "code": code,
            "redirect_uri": redirect_uri,
            "client_id": client_id,
            "code_verifier": verifier,
        }
        given: dict[str, Any] = {}
        secret = self._secret()
        if secret is not None and "client_secret_basic" in description.token_endpoint_auth_methods_supported:
            given["auth"] = (client_id, secret)
        elif secret is not None:
            form["client_secret"] = secret
        tokens = self._request("POST", description.token_endpoint, data=form, **given)
        if not isinstance(tokens.get("id_token"), str):
            raise SignInError("provider_invalid", "the provider gave no ID token")
        return Tokens(id_token=tokens["id_token"], access_token=str(tokens.get("access_token", "")))

    def _secret(self) -> str | None:
        path = self._settings.oidc_client_secret_file
        if path is None:
            return None
        try:
            return path.read_text(encoding="utf-8").strip()
        except OSError as error:
            raise SignInError("provider_invalid", f"{path} cannot be read: {error.strerror}") from error

    def claims(self, tokens: Tokens, nonce: str) -> dict[str, Any]:
        """Return what the provider vouches for: the claims of an ID token with a valid signature.

        Raises SignInError unless it is of this provider, for this client and this sign-in, and still valid.
        """
        from authlib.oidc.core import CodeIDToken
        from joserfc import jwt
        from joserfc.errors import JoseError

        try:
            try:
                token = jwt.decode(tokens.id_token, self._known_keys(), algorithms=list(ALGORITHMS))
            except (JoseError, ValueError):
                # Perhaps of a key that the provider has had for a minute.
                token = jwt.decode(tokens.id_token, self._known_keys(again=True), algorithms=list(ALGORITHMS))
            if not isinstance(token.claims, dict):
                raise SignInError("id_token_invalid", "the ID token has no claims")
            issuer, client_id = self._settings.oidc_issuer, self._settings.oidc_client_id
            options = {
                "iss": {"essential": True, "value": issuer},
                "aud": {"essential": True, "value": client_id},
                "sub": {"essential": True},
                "nonce": {"essential": True, "value": nonce},
            }
            given = {"nonce": nonce, "client_id": client_id, "access_token": tokens.access_token}
            claims = CodeIDToken(token.claims, token.header, options, given)
            claims.validate(int(time.time()), LEEWAY_S)
        except (JoseError, ValueError, TypeError, KeyError) as error:
            raise SignInError("id_token_invalid", f"the ID token is refused: {error!r}") from error
        return dict(claims)

    def _known_keys(self, *, again: bool = False) -> Any:
        address = self.description().jwks_uri
        longest_s = KEYS_AGAIN_S if again else DESCRIPTION_S
        known = self._keys
        if known is None or time.monotonic() - known[1] > longest_s:
            with self._asking:
                known = self._keys
                if known is None or time.monotonic() - known[1] > longest_s:
                    fresh = self._once_in_a_while(lambda: self._read_keys(address))
                    known = self._keys = fresh, time.monotonic()
        return known[0]

    def _read_keys(self, address: str) -> Any:
        from joserfc import jwk
        from joserfc.errors import JoseError

        document: Any = self._get(address)
        try:
            return jwk.KeySet.import_key_set(document)
        except (JoseError, ValueError, KeyError, TypeError) as error:
            raise SignInError("provider_invalid", f"{address} has no keys: {error!r}") from error

    def _get(self, address: str) -> dict[str, Any]:
        return self._request("GET", address)

    def _request(self, method: str, address: str, **given: Any) -> dict[str, Any]:
        """Return the JSON object of an answer."""
        _require_safe(address)
        context: Any = httpx2.create_ssl_context()
        if self._settings.oidc_ca_file is not None:
            context.load_verify_locations(self._settings.oidc_ca_file)
        try:
            with httpx2.Client(timeout=TIMEOUT_S, verify=context, follow_redirects=False) as client:
                response = client.request(method, address, headers={"accept": "application/json"}, **given)
                document = response.json()
        except (httpx2.HTTPError, ValueError) as error:
            raise SignInError("provider_unavailable", f"{address}: {type(error).__name__}") from error
        if response.status_code != 200 or not isinstance(document, dict):
            code = document.get("error", "") if isinstance(document, dict) else ""
            raise SignInError("provider_refused", f"{address} answers {response.status_code} {code}")
        return document


def _require_safe(address: str) -> None:
    parts = urlsplit(address)
    if parts.scheme != "https" and not (parts.scheme == "http" and parts.hostname in _LOOPBACK):
        raise SignInError("provider_invalid", f"{address} is not encrypted")
