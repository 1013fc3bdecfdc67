"""The header in which a proxy names the user who has signed in there; only trusted proxies may send it."""

import hmac
import ipaddress
from typing import Any

import structlog

from lambent_server.core.settings import ServeError, Settings
from lambent_server.http.proxies import address_of
from lambent_server.http.request import App, Receive, Scope, Send

log = structlog.get_logger()

LOGIN_NAME = "login_name"
LOGIN_ORGANISATIONS = "login_organisations"
"""Names in the state of a request; nothing else sets them."""
MAX_NAME = 200
_LOOPBACK = tuple(map(ipaddress.ip_network, ("127.0.0.0/8", "::1/128", "::ffff:127.0.0.0/104")))
SECRET_HEADER = b"x-lambent-login-secret"
MIN_SECRET = 20
"""Characters of a secret."""


def _is_local(network: str) -> bool:
    """Return whether addresses of the loopback are among those of a network."""
    known: Any = ipaddress.ip_network(network)
    return any(known.version == each.version and known.overlaps(each) for each in _LOOPBACK)


def login_secret(settings: Settings) -> bytes | None:
    """Return the secret by which the proxy that names people is known; None if its address is enough.

    Raises ServeError for a file that cannot be read, or holds no secret, and without one where an address of
    the loopback is trusted.
    """
    path = settings.login_secret_file
    if path is None:
        local = [each for each in settings.trusted_proxies if _is_local(each)]
        if settings.login_header is None or not local:
            return None
        raise ServeError(
            f"serve.login_secret_missing: LAMBENT_LOGIN_HEADER is accepted from {local[0]}, an address that "
            "every process of this machine can use; write a secret (`openssl rand -hex 32`) into a file that "
            "only the server and the proxy can read, name it in LAMBENT_LOGIN_SECRET_FILE, and let the proxy "
            "send it in X-Lambent-Login-Secret"
        )
    try:
        secret = path.read_text(encoding="ascii").strip()
    except OSError as error:
        raise ServeError(f"serve.login_secret_invalid: {path} cannot be read: {error.strerror}") from error
    except UnicodeDecodeError:
        secret = ""
    if len(secret) < MIN_SECRET or not secret.isprintable():
        raise ServeError(
            f"serve.login_secret_invalid: {path} must hold a line of at least {MIN_SECRET} ASCII characters, "
            "such as `openssl rand -hex 32` prints"
        )
    return secret.encode()


class LoginHeader:
    """ASGI middleware outside of what replaces the proxy's address by that of its client."""

    def __init__(self, app: App, settings: Settings) -> None:
        self._app = app
        self._networks = [ipaddress.ip_network(each) for each in settings.trusted_proxies]
        given = {LOGIN_NAME: settings.login_header, LOGIN_ORGANISATIONS: settings.login_organisations_header}
        self._secret = login_secret(settings)
        self._names = {key: name.lower().encode() for key, name in given.items() if name}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        if scope["type"] == "http" and LOGIN_NAME in self._names and self._trusts(scope):
            state = scope.setdefault("state", {})
            for key, name in self._names.items():
                values = [value for header, value in scope["headers"] if header.lower() == name]
                # Of two, one may be the client's own.
                if len(values) == 1 and (text := values[0].decode("latin-1").strip()):
                    # Never cut: the beginning of a name or of a list may be that of others.
                    if key == LOGIN_NAME and len(text) > MAX_NAME:
                        log.warning("login_name_too_long", header=name.decode(), characters=len(text))
                        continue
                    state[key] = text
        await self._app(scope, receive, send)

    def _trusts(self, scope: Scope) -> bool:
        """Return whether a request is the proxy's own: from its address, with the secret if there is one."""
        address = address_of(str(scope["client"][0])) if scope.get("client") else None
        trusted = address is not None and any(address in network for network in self._networks)
        return trusted and self._knows_secret(scope)

    def _knows_secret(self, scope: Scope) -> bool:
        if self._secret is None:
            return True
        given = [value.strip() for header, value in scope["headers"] if header.lower() == SECRET_HEADER]
        knows = len(given) == 1 and hmac.compare_digest(given[0], self._secret)
        if not knows and any(header.lower() == self._names[LOGIN_NAME] for header, _ in scope["headers"]):
            log.warning("login_secret_wrong", header=SECRET_HEADER.decode(), sent=len(given))
        return knows
