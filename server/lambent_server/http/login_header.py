"""The header in which a proxy names who has signed in there; it is believed from trusted proxies only."""

import ipaddress
from collections.abc import Awaitable, Callable, MutableMapping
from typing import Any

import structlog

from lambent_server.settings import Settings

log = structlog.get_logger()

Scope = MutableMapping[str, Any]
App = Callable[[Scope, Any, Any], Awaitable[None]]

LOGIN_NAME = "login_name"
LOGIN_ORGANISATIONS = "login_organisations"
"""Names in the state of a request; nothing else sets them."""
MAX_NAME = 200


class LoginHeader:
    """ASGI middleware outside of what replaces the proxy's address by that of its client."""

    def __init__(self, app: App, settings: Settings) -> None:
        self._app = app
        self._networks = [ipaddress.ip_network(each) for each in settings.trusted_proxies]
        given = {LOGIN_NAME: settings.login_header, LOGIN_ORGANISATIONS: settings.login_organisations_header}
        self._names = {key: name.lower().encode() for key, name in given.items() if name}

    async def __call__(self, scope: Scope, receive: Any, send: Any) -> None:
        """Answer one request."""
        if scope["type"] == "http" and LOGIN_NAME in self._names and self._trusts(scope.get("client")):
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

    def _trusts(self, peer: Any) -> bool:
        try:
            address = ipaddress.ip_address(peer[0])
        except (TypeError, ValueError):
            return False
        address = getattr(address, "ipv4_mapped", None) or address
        return any(address in network for network in self._networks)
