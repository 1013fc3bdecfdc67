"""Signals that something has happened; the database says what."""

from collections.abc import Callable


class Wakeups:
    """A signal from any thread to whoever listens. A missed one costs only a polling interval."""

    def __init__(self) -> None:
        self._listeners: list[Callable[[], None]] = []
        self.closing = False

    def listen(self, callback: Callable[[], None]) -> None:
        """Call `callback` at every signal, in the signalling thread."""
        self._listeners.append(callback)

    def signal(self) -> None:
        """Call all listeners."""
        for listener in self._listeners:
            listener()

    def close(self) -> None:
        """Call all listeners for the last time, so that streams end."""
        self.closing = True
        self.signal()
