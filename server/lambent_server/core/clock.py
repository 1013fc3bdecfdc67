"""Times as stored in the database (Unix seconds) and as shown by the interface (RFC 3339, UTC)."""

import secrets
import threading
import time
from datetime import UTC, datetime
from typing import overload

import structlog

log = structlog.get_logger()

LONGEST_LEAD_S = 86400.0
"""By so much a clock may go back and the time still runs on; after a longer jump it follows the clock."""
SLOWED = 0.1
"""Part of the time that passes by which a lead over the clock becomes smaller."""
JUMP_S = 1.0
"""A difference between clock and passed time from which on the clock was set."""
_ALPHABET = "0123456789abcdefghjkmnpqrstvwxyz"
_ID_DIGITS = 26
_RANDOM_BITS = 80


class SteadyTime:
    """The time that a server writes into its database: that of the database's clock, and it never goes back.

    A clock that is set back would hide what was just made behind older things, and let everything that is due
    at a time wait. So the time runs on, a tenth more slowly, until the clock has caught up. Where the clock
    is set forward, the time follows at once. For SQLite the clock is the machine's.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._restart(None, 0.0)

    def _restart(self, clock: float | None, seen: float) -> None:
        self._counted_at = time.monotonic()
        self._followed = None if clock is None else (clock, self._counted_at)
        self._lead = 0.0
        self._skipped: list[tuple[float, float]] = []
        self._last = self._clock(self._counted_at)
        lead = seen - self._last
        if JUMP_S < lead <= LONGEST_LEAD_S:
            log.warning("clock_behind", seconds=round(lead, 1))
            self._last, self._lead = seen, lead

    def _clock(self, at: float) -> float:
        """Return what the database's clock shows when the monotonic clock shows `at`."""
        if self._followed is None:
            return time.time()
        shown, when = self._followed
        return shown + at - when

    def begin(self, clock: float | None, seen: float) -> None:
        """Begin with another database, whose clock shows `clock` and whose newest row is from `seen`.

        Without `clock` the clock is that of this machine. All times are Unix seconds.
        """
        with self._lock:
            self._restart(clock, seen)

    def follow(self, clock: float) -> None:
        """Note that the database's clock shows `clock` (Unix seconds) now."""
        with self._lock:
            self._followed = clock, time.monotonic()

    def now(self) -> float:
        """Return the time in Unix seconds."""
        with self._lock:
            at = time.monotonic()
            passed, self._counted_at = max(at - self._counted_at, 0.0), at
            clock = self._clock(at)
            lead = self._last + passed - clock
            if lead < -JUMP_S:
                log.warning("clock_set_forward", seconds=round(-lead, 1))
                self._skipped.append((at, -lead))
            elif lead > self._lead + JUMP_S:
                log.warning("clock_set_back", seconds=round(lead - self._lead, 1))
            lead = max(lead - SLOWED * passed, 0.0)
            self._lead = lead if lead <= LONGEST_LEAD_S else 0.0
            self._last = clock + self._lead
            return self._last

    def skipped_s(self, age_s: float) -> float:
        """Return by how many seconds the clock was set forward during the last `age_s` seconds.

        Something that is to stay for `age_s` has not been there for so long if these are not subtracted.
        """
        with self._lock:
            since = time.monotonic() - age_s
            return sum(seconds for at, seconds in self._skipped if at > since)


_time = SteadyTime()
begin, follow, now, skipped_s = _time.begin, _time.follow, _time.now, _time.skipped_s


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


@overload
def rfc3339(at: float) -> str: ...
@overload
def rfc3339(at: float | None) -> str | None: ...
def rfc3339(at: float | None) -> str | None:
    """Return `at` (Unix seconds) as text with milliseconds; None for none."""
    return (
        None
        if at is None
        else datetime.fromtimestamp(at, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
    )


def new_id(prefix: str) -> str:
    """Return an unguessable identifier that sorts by creation time."""
    value = (int(now() * 1000) << _RANDOM_BITS) | secrets.randbits(_RANDOM_BITS)
    digits = [_ALPHABET[(value >> shift) & 31] for shift in range(5 * (_ID_DIGITS - 1), -1, -5)]
    return f"{prefix}_{''.join(digits)}"


def time_of_id(identifier: str) -> float:
    """Return when an identifier was made (Unix seconds); 0 for one that `new_id` did not make."""
    digits = identifier.rpartition("_")[2]
    if len(digits) != _ID_DIGITS or not set(digits) <= set(_ALPHABET):
        return 0.0
    value = 0
    for digit in digits:
        value = value << 5 | _ALPHABET.index(digit)
    return (value >> _RANDOM_BITS) / 1000.0
