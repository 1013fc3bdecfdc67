"""Headers of trusted proxies: the client's address (X-Forwarded-For) and scheme (X-Forwarded-Proto)."""

import ipaddress
from collections.abc import Iterator, Sequence

from lambent_server.http.request import App, Receive, Scope, Send

_SCHEMES = frozenset({"http", "https"})
Network = ipaddress.IPv4Network | ipaddress.IPv6Network
Address = ipaddress.IPv4Address | ipaddress.IPv6Address


class Proxies:
    """ASGI middleware that applies the headers of trusted proxies, and ignores those of everyone else."""

    def __init__(self, app: App, networks: Sequence[str]) -> None:
        self._app = app
        self._networks = [ipaddress.ip_network(each, strict=False) for each in networks]

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        peer = scope.get("client")
        if scope["type"] == "http" and peer and self._trusts(address_of(str(peer[0]))):
            # Each header by itself: a proxy may know the scheme and hide the address.
            client = self._client(list(_items(scope, b"x-forwarded-for")))
            if client is not None:
                scope["client"] = (client, 0)
            schemes = [each.lower() for each in _items(scope, b"x-forwarded-proto")]
            # Of several proxies, the first is the one that the client has spoken to.
            if schemes and all(each in _SCHEMES for each in schemes):
                scope["scheme"] = schemes[0]
        await self._app(scope, receive, send)

    def _client(self, hops: list[str]) -> str | None:
        """Return the last address that is not a proxy's: the client may have made up those before it."""
        addresses = [address_of(hop) for hop in hops]
        for address in reversed(addresses):
            if address is None:
                return None
            if not self._trusts(address):
                return str(address)
        return str(addresses[0]) if addresses else None

    def _trusts(self, address: Address | None) -> bool:
        return address is not None and any(address in network for network in self._networks)


def _items(scope: Scope, name: bytes) -> Iterator[str]:
    """Yield the members of a list in the headers of a request, of which there may be several."""
    for header, value in scope["headers"]:
        if header.lower() == name:
            yield from (item.strip() for item in value.decode("latin-1").split(",") if item.strip())


def address_of(text: str) -> Address | None:
    """Return the address in a text, without port and zone; None if there is none."""
    if text.startswith("["):
        text = text[1:].partition("]")[0]
    elif text.count(":") == 1:
        text = text.partition(":")[0]
    try:
        address = ipaddress.ip_address(text.partition("%")[0])
    except ValueError:
        return None
    # How a socket for both families names a client of the older one.
    return getattr(address, "ipv4_mapped", None) or address
