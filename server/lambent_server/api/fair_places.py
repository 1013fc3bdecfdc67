"""Places for work that takes long: tenants take turns, and none has more than its share of them."""

import asyncio
from collections import Counter
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from typing import Any, TypeVar

from anyio import CapacityLimiter, to_thread

from lambent_server.core.settings import Settings

Result = TypeVar("Result")


@dataclass(frozen=True, slots=True, eq=False)
class _Waiting:
    tenant_id: str
    client: str
    called: asyncio.Future[None]


class FairPlaces:
    """The places of one process. All methods are called in the event loop.

    A free place goes to the tenant that has the fewest, of these to the one that got one longest ago, and in
    a tenant to the client for which the same holds. Whoever has a full share waits while others pass by.
    """

    def __init__(self, total: int, *, tenant_share: float, client_share: float) -> None:
        self._total = total
        self._tenant = max(int(tenant_share * total), 1)
        self._client = max(int(client_share * total), 1)
        self._used: Counter[tuple[str, ...]] = Counter()
        self._in_use = 0
        self._turns = 0
        self._served: dict[tuple[str, ...], int] = {}
        self._queue: list[_Waiting] = []
        self._threads = CapacityLimiter(total)

    @classmethod
    def shared(cls, total: int, settings: Settings) -> "FairPlaces":
        """Return so many places, with the shares of the settings."""
        return cls(total, tenant_share=settings.tenant_share, client_share=settings.client_share)

    async def run(self, tenant_id: str, client: str, act: Callable[..., Result], *arguments: Any) -> Result:
        """Return what `act` returns, called in a thread once there is a place for it."""
        async with self.place(tenant_id, client):
            return await to_thread.run_sync(act, *arguments, limiter=self._threads)

    @asynccontextmanager
    async def place(self, tenant_id: str, client: str) -> AsyncIterator[None]:
        """Hold a place inside the `with` block, once there is one."""
        waiting = _Waiting(tenant_id, client, asyncio.get_running_loop().create_future())
        self._queue.append(waiting)
        self._call()
        try:
            await waiting.called
        except BaseException:
            if waiting in self._queue:
                self._queue.remove(waiting)
            else:
                self._give_back(waiting)
            raise
        try:
            yield
        finally:
            self._give_back(waiting)

    def _call(self) -> None:
        """Call those whose turn it is, while there are places."""
        while self._in_use < self._total:
            able = [each for each in self._queue if self._may_have_one(each)]
            if not able:
                return
            # The first of equals is the one that has waited longest.
            chosen = min(able, key=self._turn)
            self._queue.remove(chosen)
            self._in_use += 1
            self._turns += 1
            for name in _names(chosen):
                self._used[name] += 1
                self._served[name] = self._turns
            chosen.called.set_result(None)

    def _may_have_one(self, waiting: _Waiting) -> bool:
        tenant, client = _names(waiting)
        # Cancelled ones leave the queue themselves, a moment later.
        is_there = not waiting.called.done()
        return is_there and self._used[tenant] < self._tenant and self._used[client] < self._client

    def _turn(self, waiting: _Waiting) -> tuple[int, ...]:
        return tuple(
            number for name in _names(waiting) for number in (self._used[name], self._served.get(name, 0))
        )

    def _give_back(self, waiting: _Waiting) -> None:
        self._in_use -= 1
        self._used -= Counter(_names(waiting))
        if not self._in_use and not self._queue:
            self._served.clear()
        self._call()


def _names(waiting: _Waiting) -> tuple[tuple[str, ...], tuple[str, ...]]:
    return (waiting.tenant_id,), (waiting.tenant_id, waiting.client)
