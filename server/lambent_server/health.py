"""Health checks of a server's parts, each in its own thread so that one that hangs does not block others."""

import asyncio
import errno
import os
import shutil
import tempfile
import threading
from collections.abc import Callable
from concurrent.futures import Future

from lambent_server.server_state import Notices
from lambent_server.services import Services
from lambent_server.settings import Settings

PROBE_S = 1.0
NOTICES = "notices"
"""The check that names what operators have told the server, or an error: nothing that works or does not."""
PROBE_BYTES = 4096


class Health:
    """Runs each check at most once at a time."""

    def __init__(self, services: Services) -> None:
        notices = Notices(services.database)
        self._probes: dict[str, Callable[[], str]] = {
            "database": lambda: services.database.probe(PROBE_S),
            "disk": lambda: probe_disk(services.settings),
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


def _answer(asked: Future[str], probe: Callable[[], str]) -> None:
    try:
        asked.set_result(probe())
    except Exception as error:
        asked.set_result(type(error).__name__)


def probe_disk(settings: Settings) -> str:
    """Return whether the data folder is writable and has the space that must stay free."""
    try:
        with tempfile.TemporaryFile(dir=settings.scratch) as file:
            file.write(bytes(PROBE_BYTES))
            file.flush()
            os.fsync(file.fileno())
        free = shutil.disk_usage(settings.data).free
    except OSError as error:
        return "full" if error.errno in (errno.ENOSPC, errno.EDQUOT) else "unwritable"
    return "ok" if free >= settings.disk_floor_bytes else "low"
