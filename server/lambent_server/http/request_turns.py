"""Turns of requests that are answered in threads: no tenant keeps all threads busy while others wait.

A request takes a place when it is complete and gives it back with the beginning of its response, so neither a
slow sender nor a slow reader holds one. Streams and uploads keep no thread while they wait, and take none.
"""

import inspect
from contextlib import AsyncExitStack

from fastapi import Request

from lambent_server.api.fair_places import FairPlaces

THREADS = 40
"""As many as anyio has for requests."""
TURN = "turn"
"""In the state of a request of a known client."""


class Turn:
    """The place of one request."""

    def __init__(self, places: FairPlaces, tenant_id: str, client: str) -> None:
        self._places = places
        self._tenant_id = tenant_id
        self._client = client
        self._held = AsyncExitStack()

    async def take(self) -> None:
        """Wait for a place."""
        await self._held.enter_async_context(self._places.place(self._tenant_id, self._client))

    async def leave(self) -> None:
        """Give the place back, if the request has one."""
        await self._held.aclose()


async def take_turn(request: Request) -> None:
    """Wait until it is the turn of a request whose route runs in a thread."""
    turn: Turn | None = request.scope["state"].get(TURN)
    if turn is not None and not inspect.iscoroutinefunction(request.scope["route"].endpoint):
        await turn.take()
