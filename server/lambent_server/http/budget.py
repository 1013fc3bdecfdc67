"""The requests of each kind that are in progress, in all and of each client.

A kind never uses the places of another, and a client only its share of a kind. Requests that operators and
browsers depend on (`/healthz`, `/readyz`, sign-in) take none of these places.
"""

import ipaddress
import math
import re
import time
from collections import Counter
from dataclasses import dataclass
from typing import Self

from starlette.datastructures import Headers

from lambent_server.api.outside_text import announced_bytes
from lambent_server.api.problems import Problem
from lambent_server.core.metrics import REQUESTS_REFUSED
from lambent_server.core.settings import Settings

STREAMS = "streams"
BODIES = "bodies"
REQUESTS = "requests"
SIGN_INS = "sign_ins"

# Part of all connections that may belong to requests of these kinds; the rest wait for their first byte.
BUSY_SHARE = 0.75
# Part of all connections on which users may be signing in.
SIGN_IN_SHARE = 1 / 32
# A body of at most this many bytes counts as being sent only if it does not come at once.
SMALL_BODY_BYTES = 64 * 1024
RETRY_AFTER_S = 5

_NOT_COUNTED = frozenset({"/healthz", "/readyz", "/v1/version"})
_SIGN_IN = re.compile(r"/v1/(login|sign-in(/callback)?)")
_EVERYBODY = ""


@dataclass(frozen=True, slots=True)
class _Limits:
    """How many requests of one kind may be in progress; `setting` is the one to change."""

    setting: str
    total: int
    tenant: int
    client: int


class Budget:
    """The places of one process. All methods are called in the event loop."""

    def __init__(self, settings: Settings, connections: int | None = None) -> None:
        """Divide `connections`, at most those of the settings."""
        allowed = settings.max_connections if connections is None else connections
        wanted = settings.max_streams + settings.max_bodies + settings.max_requests
        scale = min(1.0, BUSY_SHARE * allowed / wanted)
        self.limits = {
            kind: _divided(f"max_{kind}", scale * getattr(settings, f"max_{kind}"), settings)
            for kind in (STREAMS, BODIES, REQUESTS)
        }
        self.limits[SIGN_INS] = _divided("max_connections", SIGN_IN_SHARE * allowed, settings)
        self.max_waiting = allowed - sum(limits.total for limits in self.limits.values())
        """Connections that may wait for a request."""
        self.max_waiting_of_client = max(int(settings.client_share * self.max_waiting), 1)
        self.used: Counter[tuple[str, str]] = Counter()
        self.requested_at = -math.inf
        """When the last request began that is answered at once, by the monotonic clock."""

    def in_use(self, kind: str, client: str = _EVERYBODY) -> int:
        """Return how many requests of this kind are in progress, in all or of one client."""
        return self.used[kind, client]

    def requested_within(self, seconds: float) -> bool:
        """Return whether requests are in progress and the last of them began less than `seconds` ago."""
        return self.in_use(REQUESTS) > 0 and time.monotonic() - self.requested_at < seconds


def _divided(setting: str, total: float, settings: Settings) -> _Limits:
    parts = (1.0, settings.tenant_share, settings.client_share)
    return _Limits(setting, *(max(int(part * total), 1) for part in parts))


def kind_of(method: str, path: str, headers: Headers) -> str | None:
    """Return the kind of a request, or None for those that are always answered."""
    if path in _NOT_COUNTED:
        return None
    if path == "/v1/events" and method == "GET":
        return STREAMS
    if _SIGN_IN.fullmatch(path):
        return SIGN_INS
    if announced_bytes(headers) > SMALL_BODY_BYTES:
        return BODIES
    return REQUESTS


def client_of_address(host: str) -> str:
    """Return the name of the client at an address: IPv6 by its network, for a host has many addresses."""
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return f"address {host}"
    mapped = getattr(address, "ipv4_mapped", None)
    if mapped is not None or address.version == 4:
        return f"address {mapped or address}"
    return f"address {ipaddress.ip_network((address, 64), strict=False)}"


class Place:
    """What one request uses of the budget, until it ends."""

    def __init__(self, budget: Budget, kind: str | None) -> None:
        self._budget = budget
        self.kind = kind
        self._clients: list[str] = []

    def __enter__(self) -> Self:
        """Return the place, which is still empty."""
        return self

    def __exit__(self, *_: object) -> None:
        """Free the place."""
        self._leave()
        self._clients = []

    def take(self, *clients: str) -> None:
        """Count the request for these clients too; raise the problem if one of them has too many."""
        new = [client for client in clients if client not in self._clients]
        if self.kind is not None:
            self._require_room(self.kind, new if self._clients else [_EVERYBODY, *new])
            self._budget.used.update((self.kind, client) for client in new)
            if not self._clients:
                self._budget.used[self.kind, _EVERYBODY] += 1
                if self.kind == REQUESTS:
                    self._budget.requested_at = time.monotonic()
        self._clients += new

    def move(self, kind: str, *, check: bool) -> None:
        """Count the request as one of another kind; with `check`, raise the problem if there are too many."""
        if self.kind in (None, kind) or not self._clients:
            return
        if check:
            self._require_room(kind, [_EVERYBODY, *self._clients])
        self._leave()
        self.kind = kind
        self._budget.used.update((kind, client) for client in [_EVERYBODY, *self._clients])

    def _leave(self) -> None:
        if self.kind is None or not self._clients:
            return
        used = self._budget.used
        for client in [_EVERYBODY, *self._clients]:
            used[self.kind, client] -= 1
            if used[self.kind, client] <= 0:
                del used[self.kind, client]

    def _require_room(self, kind: str, clients: list[str]) -> None:
        limits = self._budget.limits[kind]
        for client in clients:
            limit = limits.client
            if client == _EVERYBODY:
                limit = limits.total
            elif client.startswith("tenant "):
                limit = limits.tenant
            used = self._budget.in_use(kind, client)
            if used >= limit:
                REQUESTS_REFUSED.labels(f"quota_{kind}" if client else "server_full").inc()
                raise _refusal(kind, client, limits.setting, limit, used)


def _refusal(kind: str, client: str, setting: str, limit: int, used: int) -> Problem:
    what = {
        STREAMS: "event streams; one stream can follow many jobs",
        BODIES: "requests whose body is still being sent",
        REQUESTS: "requests in progress",
        SIGN_INS: "sign-ins in progress",
    }[kind]
    owner = client.partition(" ")[0]
    whose = f"this {owner} has" if owner else "there are"
    return Problem(
        429 if owner else 503,
        f"quota_{kind}" if owner else "server_full",
        f"{whose} {used} of {limit} possible {what}",
        retryable=True,
        headers={"retry-after": str(RETRY_AFTER_S), "connection": "close"},
        members={"quota": {"name": setting, "of": owner or "server", "limit": limit, "used": used}},
    )
