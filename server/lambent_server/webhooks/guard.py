"""The guard of webhooks: the address is checked at every attempt, and only what was checked is used.

Against requests forged on behalf of the server (SSRF): a strict form of URL, https on a few ports, and public
unicast addresses only. Names and networks that an operator lists are exempt from the last rule.
"""

import ipaddress
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Self

from lambent_server.core.settings import Settings

Address = ipaddress.IPv4Address | ipaddress.IPv6Address
Network = ipaddress.IPv4Network | ipaddress.IPv6Network

MAX_URL = 2000
_DEFAULT_PORTS = {"https": 443, "http": 80}
# Only characters that every reader of URLs takes for the same: no user, no zone, no other alphabets.
_URL = re.compile(
    r"(?P<scheme>https?)://"
    r"(?P<host>\[[0-9a-f:.]{2,45}\]|[a-z0-9._-]{1,253})"
    r"(?::(?P<port>[0-9]{1,5}))?"
    r"(?P<path>/[A-Za-z0-9\-._~:/?@!$&'()*+,;=%\[\]]*)?",
    re.IGNORECASE,
)
_LABEL = re.compile(r"[a-z0-9_]([a-z0-9_-]{0,61}[a-z0-9_])?")
# What readers of URLs take for a number, and thus for an IPv4 address in one of its old forms.
_NUMBER = re.compile(r"[0-9]+|0x[0-9a-f]*")

# Global unicast, and those parts of it that lead elsewhere: to an IPv4 address, a test or a protocol.
_UNICAST_6 = ipaddress.IPv6Network("2000::/3")
_NOT_PUBLIC = tuple(
    ipaddress.ip_network(each)
    for each in (
        "2001::/23",  # protocol assignments, Teredo among them
        "2001:db8::/32",  # documentation
        "2002::/16",  # 6to4
        "3fff::/20",  # documentation
        "192.0.0.0/24",  # protocol assignments; a metadata service uses one
        "192.88.99.0/24",  # relays of 6to4
        "168.63.129.16/32",  # the platform's own service in one cloud
    )
)


class RefusedAddress(Exception):  # noqa: N818 (an answer, not a mistake)
    """A URL or an address that webhooks must not be sent to; `code` is stable."""

    def __init__(self, code: str, message: str) -> None:
        super().__init__(message)
        self.code = code


def is_public(address: Address) -> bool:
    """Return whether an address is one of a single machine on the public Internet.

    Addresses that wrap another one (IPv4-mapped, NAT64, 6to4, Teredo) are not, whatever they wrap.
    """
    if any(address in network for network in _NOT_PUBLIC if network.version == address.version):
        return False
    if isinstance(address, ipaddress.IPv6Address):
        return address.scope_id is None and address in _UNICAST_6
    return address.is_global and not address.is_multicast and not address.is_reserved


@dataclass(frozen=True, kw_only=True, slots=True)
class Target:
    """The parts of a URL that has passed the check of its form."""

    scheme: str
    host: str
    """In small letters; IPv6 without brackets."""
    port: int
    path: str
    """With the query."""

    @property
    def address(self) -> Address | None:
        """The address, if the URL names one instead of a host."""
        return _address(self.host)

    @property
    def place(self) -> str:
        """Host and port, as limits and logs name them; nothing of the path, which may contain a secret."""
        return f"{_bracketed(self.host)}:{self.port}"

    @property
    def host_header(self) -> str:
        """The value of the Host header."""
        default = _DEFAULT_PORTS[self.scheme] == self.port
        return _bracketed(self.host) if default else self.place

    def url_at(self, address: str) -> str:
        """Return the URL with the host replaced by an address that has been checked."""
        return f"{self.scheme}://{_bracketed(address)}:{self.port}{self.path}"


def _bracketed(host: str) -> str:
    return f"[{host}]" if ":" in host else host


def _address(text: str) -> Address | None:
    try:
        return ipaddress.ip_address(text)
    except ValueError:
        return None


@dataclass(frozen=True, kw_only=True, slots=True)
class Guard:
    """The rules of one server."""

    schemes: frozenset[str] = frozenset({"https"})
    ports: frozenset[int] = frozenset({443})
    hosts: frozenset[str] = frozenset()
    """Names whose addresses are not judged; "*.example.com" stands for all names below it."""
    networks: tuple[Network, ...] = ()
    """Networks whose addresses are allowed, public or not."""
    only_listed: bool = False
    """Refuse everything that neither `hosts` nor `networks` contain."""

    @classmethod
    def of(cls, settings: Settings) -> Self:
        """Return the rules that the settings describe."""
        networks, hosts = [], set()
        for entry in settings.webhook_allowed:
            try:
                networks.append(ipaddress.ip_network(entry))
            except ValueError:
                hosts.add(entry.lower())
        return cls(
            schemes=frozenset({"https", "http"} if settings.webhook_allow_http else {"https"}),
            ports=frozenset(settings.webhook_ports),
            hosts=frozenset(hosts),
            networks=tuple(networks),
            only_listed=settings.webhook_only_allowed,
        )

    def parse(self, url: str) -> Target:
        """Return the parts of a URL; raises RefusedAddress if webhooks are never sent there."""
        match = _URL.fullmatch(url) if len(url) <= MAX_URL else None
        if match is None:
            raise RefusedAddress(
                "url_invalid",
                "this is not a plain URL such as https://example.com/path: no user, no fragment, host names "
                f"in their ASCII form, at most {MAX_URL} characters",
            )
        scheme, host = match["scheme"].lower(), match["host"].lower()
        if scheme not in self.schemes:
            raise RefusedAddress("scheme_refused", f"webhooks are sent by {self._schemes()}, not {scheme}")
        port = int(match["port"] or _DEFAULT_PORTS[scheme])
        if port not in self.ports:
            ports = ", ".join(map(str, sorted(self.ports)))
            raise RefusedAddress("port_refused", f"webhooks are sent to ports {ports}, not {port}")
        target = Target(scheme=scheme, host=_host(host), port=port, path=match["path"] or "/")
        if target.address is not None:
            self.permitted(target, [target.host])
        elif self.only_listed and not self.networks and not self._is_listed(target.host):
            raise RefusedAddress("address_refused", "this server sends webhooks to listed hosts only")
        return target

    def _schemes(self) -> str:
        return " or ".join(sorted(self.schemes, reverse=True))

    def _is_listed(self, host: str) -> bool:
        parents = (f"*.{host.split('.', count)[-1]}" for count in range(1, host.count(".") + 1))
        return host in self.hosts or any(parent in self.hosts for parent in parents)

    def permitted(self, target: Target, addresses: Sequence[str]) -> list[str]:
        """Return the addresses of a target to which a connection may be made.

        Raises RefusedAddress if there are none, or if one of them is not allowed: an honest name does not
        lead to a public and a private address at once. The message names no address, for it may be one of
        this network.
        """
        if target.address is None and self._is_listed(target.host):
            return list(addresses)
        if not addresses:
            raise RefusedAddress("name_unknown", f"the host name {target.host} has no address")
        if not all(map(self._is_permitted, addresses)):
            reason = "is not listed" if self.only_listed else "is not a public address"
            raise RefusedAddress("address_refused", f"the address of {target.host} {reason}")
        return list(addresses)

    def _is_permitted(self, text: str) -> bool:
        address = _address(text)
        if address is None:
            return False
        return _within(address, self.networks) or (not self.only_listed and is_public(address))


def _host(host: str) -> str:
    """Return a host without brackets; raises RefusedAddress for what is neither a name nor an address."""
    if host.startswith("["):
        address = _address(host[1:-1])
        if isinstance(address, ipaddress.IPv6Address):
            return str(address)
    elif _address(host) is not None:
        return host
    else:
        labels = host.split(".")
        if all(map(_LABEL.fullmatch, labels)) and not _NUMBER.fullmatch(labels[-1]):
            return host
    raise RefusedAddress("url_invalid", f"{host[:100]!r} is neither a host name nor an IP address")


def _within(address: Address, networks: Iterable[Network]) -> bool:
    return any(address in network for network in networks if network.version == address.version)
