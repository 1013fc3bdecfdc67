"""Signals to waiting requests that something has happened; the database says what."""

import asyncio
import threading
from collections.abc import Callable


class Wakeups:
    """A signal from any thread to any number of coroutines. A missed one costs only a polling interval."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._waiting: set[tuple[asyncio.AbstractEventLoop, asyncio.Event]] = set()
        self._listeners: list[Callable[[], None]] = []
        self.closing = False

    def listen(self, callback: Callable[[], None]) -> None:
        """Call `callback` at every signal, in the signalling thread."""
        self._listeners.append(callback)

    def signal(self) -> None:
        """Wake all listeners."""
        with self._lock:
            waiting, self._waiting = self._waiting, set()
        for loop, event in waiting:
            if not loop.is_closed():
                loop.call_soon_threadsafe(event.set)
        for listener in self._listeners:
            listener()

    def close(self) -> None:
        """Wake all listeners for the last time, so that streams end."""
        self.closing = True
        self.signal()

    async def wait(self, timeout_s: float) -> bool:
        """Wait for the next signal, at most `timeout_s`; return whether there was one."""
        if self.closing:
            return True
        entry = (asyncio.get_running_loop(), asyncio.Event())
        with self._lock:
            self._waiting.add(entry)
        try:
            return await asyncio.wait_for(entry[1].wait(), timeout_s)
        except TimeoutError:
            return False
        finally:
            with self._lock:
                self._waiting.discard(entry)
