"""The attempts that may be under way at once: in all, of each tenant, and at each receiver.

A tenant has its share (`tenant_share`) of the places, and half as many after each attempt that was slow, so
that receivers that accept a connection and never answer soon take one place only; every quick one gives one
back. The last quarter of all places is for tenants that have none and whose receivers are not slow.
"""

import time
from collections import Counter
from collections.abc import Callable

from lambent_server.core.settings import Settings

SLOW_PART = 0.5
"""An attempt is slow that takes this part of the time limit, whatever comes of it."""
HUNG_AFTER = 2
"""Time-outs in a row after which a receiver gets one attempt at a time, with a shorter limit."""
HUNG_PART = 0.25
"""Part of the time limit that such a receiver gets."""
FORGET_S = 300.0
"""Time without an attempt after which a receiver's time-outs are forgotten."""
SPARE_PART = 0.25
ALL_TENANTS = 2
"""All tenants together may have so many times `webhook_per_host` attempts at one host."""
_FORGET_ABOVE = 10_000

Receiver = tuple[str, str]
"""Tenant and host: what one tenant's deliveries meet says nothing about those of another."""


class Places:
    """The places of one sender. All methods are called in its event loop."""

    def __init__(self, settings: Settings, clock: Callable[[], float] = time.monotonic) -> None:
        self._settings = settings
        self._clock = clock
        self._total = settings.webhook_concurrency
        self._spare = int(SPARE_PART * self._total)
        self._share = max(int(settings.tenant_share * self._total), 1)
        self._of_tenants: Counter[str] = Counter()
        self._of_hosts: Counter[str] = Counter()
        self._of_receivers: Counter[Receiver] = Counter()
        self._most: dict[str, int] = {}
        self._hung: dict[Receiver, tuple[int, float]] = {}
        self._served: dict[str, float] = {}

    def copy(self) -> "Places":
        """Return places in the same state, to try out what could be taken."""
        other = Places(self._settings, self._clock)
        for name in ("_of_tenants", "_of_hosts", "_of_receivers", "_most", "_hung", "_served"):
            setattr(other, name, getattr(self, name).copy())
        return other

    @property
    def free(self) -> int:
        """Return how many places are free."""
        return max(self._total - self._of_tenants.total(), 0)

    def turn(self, tenant_id: str) -> tuple[int, float]:
        """Return what tenants are sorted by: who has the fewest places, or had one longest ago, is first."""
        return self._of_tenants[tenant_id], self._served.get(tenant_id, 0.0)

    def has_room(self, tenant_id: str) -> bool:
        """Return whether a tenant may have one more place."""
        used, most = self._of_tenants[tenant_id], self._most.get(tenant_id, self._share)
        is_modest = used == 0 and most == self._share
        return used < most and self.free > (0 if is_modest else self._spare)

    def may_reach(self, tenant_id: str, host: str) -> bool:
        """Return whether one more attempt of a tenant may be made at a host."""
        own = self._of_receivers[tenant_id, host]
        if own and self._is_hung((tenant_id, host)):
            return False
        most = self._settings.webhook_per_host
        # Where one tenant has all that it may, there is still room for others.
        return own < most and self._of_hosts[host] < ALL_TENANTS * most

    def full_hosts(self, tenant_id: str) -> list[str]:
        """Return the hosts at which a tenant may make no further attempt now."""
        return [host for host in self._of_hosts if not self.may_reach(tenant_id, host)]

    def timeout_s(self, tenant_id: str, host: str) -> float:
        """Return the time limit of an attempt."""
        part = HUNG_PART if self._is_hung((tenant_id, host)) else 1.0
        return part * self._settings.webhook_timeout_s

    def take(self, tenant_id: str, host: str) -> None:
        """Take a place."""
        self._of_tenants[tenant_id] += 1
        self._of_hosts[host] += 1
        self._of_receivers[tenant_id, host] += 1
        self._served[tenant_id] = self._clock()

    def leave(self, tenant_id: str, host: str) -> None:
        """Give a place back."""
        self._of_tenants -= Counter([tenant_id])
        self._of_hosts -= Counter([host])
        self._of_receivers -= Counter([(tenant_id, host)])

    def learn(self, tenant_id: str, host: str, *, seconds: float, timed_out: bool) -> None:
        """Give a tenant fewer places after a slow attempt, and one more after any other."""
        most = self._most.pop(tenant_id, self._share)
        slow = timed_out or seconds >= SLOW_PART * self._settings.webhook_timeout_s
        most = max(most // 2, 1) if slow else most + 1
        if most < self._share:
            self._most[tenant_id] = most
        self._forget()
        receiver = (tenant_id, host)
        count, _ = self._hung.pop(receiver, (0, 0.0))
        if timed_out:
            self._hung[receiver] = (count + 1, self._clock())

    def _is_hung(self, receiver: Receiver) -> bool:
        count, at = self._hung.get(receiver, (0, 0.0))
        return count >= HUNG_AFTER and self._clock() - at < FORGET_S

    def _forget(self) -> None:
        since = self._clock() - FORGET_S
        if len(self._hung) > _FORGET_ABOVE:
            self._hung = {name: timeouts for name, timeouts in self._hung.items() if timeouts[1] > since}
        if len(self._served) > _FORGET_ABOVE:
            self._served = {name: at for name, at in self._served.items() if at > since}
