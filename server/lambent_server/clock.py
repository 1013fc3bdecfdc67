"""Times as stored in the database (Unix seconds) and as shown by the interface (RFC 3339, UTC)."""

import secrets
import time
from datetime import UTC, datetime

_ALPHABET = "0123456789abcdefghjkmnpqrstvwxyz"


def now() -> float:
    """Return the time in Unix seconds."""
    return time.time()


class LivedTime:
    """Seconds during which this process was running: at most `longest_pause_s` are counted per pause.

    The monotonic clock stands still while the machine sleeps (Linux, macOS), but runs on while a virtual
    machine or this process is stopped.
    """

    def __init__(self, longest_pause_s: float) -> None:
        self._longest_pause_s = longest_pause_s
        self._looked_at = time.monotonic()
        self.seconds = 0.0

    def pass_on(self) -> None:
        """Count the time since the last call."""
        at = time.monotonic()
        self.seconds += min(at - self._looked_at, self._longest_pause_s)
        self._looked_at = at


def rfc3339(at: float) -> str:
    """Return `at` (Unix seconds) as text with milliseconds."""
    return datetime.fromtimestamp(at, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def new_id(prefix: str) -> str:
    """Return an unguessable identifier that sorts by creation time."""
    value = (int(time.time() * 1000) << 80) | secrets.randbits(80)
    digits = [_ALPHABET[(value >> shift) & 31] for shift in range(125, -1, -5)]
    return f"{prefix}_{''.join(digits)}"
