"""Health checks of a server's parts, each in its own thread so that one that hangs does not block others."""

import asyncio
import shutil
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future

from lambent_server.cluster.server_state import Notices
from lambent_server.core.settings import Settings
from lambent_server.services import Services
from lambent_server.storage.store import probe_folder

PROBE_S = 1.0
STORE_S = 10.0
"""How long an answer of the store is kept: health needs no key, and requests to a bucket cost money."""
NOTICES = "notices"
"""The check that returns the names of the operators' notices; unlike the others it cannot fail a server."""


class Health:
    """Runs each check at most once at a time."""

    def __init__(self, services: Services) -> None:
        notices = Notices(services.database)
        self._probes: dict[str, Callable[[], str]] = {
            "database": lambda: services.database.probe(PROBE_S),
            "disk": lambda: probe_disk(services.settings),
            "store": _Seldom(services.store.probe, STORE_S),
            NOTICES: lambda: " ".join(sorted(notices.now())),
        }
        self._asked: dict[str, Future[str]] = {}

    async def checks(self) -> dict[str, str]:
        """Return "ok" or a word for the problem of each part; "timeout" if it does not answer in time."""
        answers = await asyncio.gather(*(self._check(name) for name in self._probes))
        return dict(zip(self._probes, answers, strict=True))

    async def _check(self, name: str) -> str:
        asked = self._asked.get(name)
        if asked is None or asked.done():
            asked = self._asked[name] = Future()
            # A daemon thread, so that one that hangs does not keep the server from exiting.
            threading.Thread(target=_answer, args=(asked, self._probes[name]), daemon=True).start()
        try:
            return await asyncio.wait_for(asyncio.shield(asyncio.wrap_future(asked)), 1.5 * PROBE_S)
        except TimeoutError:
            return "timeout"


class _Seldom:
    """A check whose good answer is kept for a while."""

    def __init__(self, probe: Callable[[], str], kept_s: float) -> None:
        self._probe, self._kept_s = probe, kept_s
        self._until = float("-inf")

    def __call__(self) -> str:
        if time.monotonic() < self._until:
            return "ok"
        answer = self._probe()
        if answer == "ok":
            self._until = time.monotonic() + self._kept_s
        return answer


def _answer(asked: Future[str], probe: Callable[[], str]) -> None:
    try:
        asked.set_result(probe())
    except Exception as error:
        asked.set_result(type(error).__name__)


def probe_disk(settings: Settings) -> str:
    """Return whether the data folder is writable and has the space that must stay free."""
    state = probe_folder(settings.scratch)
    if state != "ok":
        return state
    free = shutil.disk_usage(settings.data).free
    return "ok" if free >= settings.disk_floor_bytes else "low"
