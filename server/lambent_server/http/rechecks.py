"""Checks that clients of open streams may still read, made once for all streams of one credential."""

import time
from collections.abc import Callable, Hashable

from lambent_server.accounts.who import Who

_FORGET_ABOVE = 10_000

Identify = Callable[[], Who | None]
"""Looks up again who makes a request; None if that is no longer accepted."""


class Rechecks:
    """Remembers for `keep_s` what was found: a thousand streams of one key cost one look at the database."""

    def __init__(self, keep_s: float) -> None:
        self._keep_s = keep_s
        self._found: dict[Hashable, tuple[float, Who | None]] = {}

    def who(self, credential: Hashable, identify: Identify) -> Who | None:
        """Return what `identify` says of a credential, or said within the last `keep_s`; from any thread."""
        at, who = self._found.get(credential, (0.0, None))
        if time.monotonic() - at < self._keep_s:
            return who
        asked_at = time.monotonic()
        who = identify()
        if len(self._found) >= _FORGET_ABOVE:
            self._found.clear()
        # As of the time of the question: the answer may be old already.
        self._found[credential] = (asked_at, who)
        return who
