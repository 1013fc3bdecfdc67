"""Times as the database keeps them (Unix seconds) and as the interface shows them (RFC 3339, UTC)."""

import secrets
import time
from datetime import UTC, datetime

_ALPHABET = "0123456789abcdefghjkmnpqrstvwxyz"


def now() -> float:
    """Return the time in Unix seconds."""
    return time.time()


class LivedTime:
    """Seconds that this process was awake for: of one pause at most `longest_pause_s` are counted.

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
    """Return an identifier that nobody can guess and that sorts by the time it was made."""
    value = (int(time.time() * 1000) << 80) | secrets.randbits(80)
    digits = [_ALPHABET[(value >> shift) & 31] for shift in range(125, -1, -5)]
    return f"{prefix}_{''.join(digits)}"
