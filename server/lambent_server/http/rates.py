"""Limits on how fast a key, browser or organisation may write, and an address sign in: token buckets.

Each server has its own buckets, so that with several of them a client may write as many times as fast.
"""

import math
import time
from collections.abc import Callable

from lambent_server.api.problems import Problem
from lambent_server.core.metrics import REQUESTS_REFUSED
from lambent_server.core.settings import Settings

_FORGET_ABOVE = 10_000
_SIGN_IN = "sign-in"


class Rates:
    """The buckets of one process. All methods are called in the event loop."""

    def __init__(self, settings: Settings, clock: Callable[[], float] = time.monotonic) -> None:
        self._settings = settings
        self._clock = clock
        # Tokens that are left, and when that was.
        self._buckets: dict[str, tuple[float, float]] = {}

    def take(self, tenant_id: str, credential: str) -> None:
        """Count one write; raise the problem if the organisation or the credential writes too fast."""
        self._take(
            {
                f"tenant {tenant_id}": self._settings.organisation_writes_per_s,
                credential: self._settings.client_writes_per_s,
            }
        )

    def take_sign_in(self, client: str) -> None:
        """Count one request to sign in; raise the problem if there are too many.

        `client` is a name of `budget.client_of_address`.
        """
        self._take({f"{client} {_SIGN_IN}": self._settings.sign_ins_per_s})

    def _take(self, per_s: dict[str, float]) -> None:
        left = {name: self._left(name, rate) for name, rate in per_s.items() if rate > 0}
        for name, tokens in left.items():
            if tokens < 1.0:
                REQUESTS_REFUSED.labels("rate_limited").inc()
                raise _too_fast(name, per_s[name], wait_s=(1.0 - tokens) / per_s[name])
        if len(self._buckets) > _FORGET_ABOVE:
            self._forget_full()
        at = self._clock()
        self._buckets.update({name: (tokens - 1.0, at) for name, tokens in left.items()})

    def _left(self, name: str, rate: float) -> float:
        most = max(rate * self._settings.writes_burst_s, 1.0)
        tokens, at = self._buckets.get(name, (most, self._clock()))
        return min(most, tokens + rate * (self._clock() - at))

    def _forget_full(self) -> None:
        """Forget buckets that have not been used for as long as they take to fill."""
        since = self._clock() - self._settings.writes_burst_s
        self._buckets = {name: bucket for name, bucket in self._buckets.items() if bucket[1] > since}


def _too_fast(name: str, rate: float, wait_s: float) -> Problem:
    owner = "organisation" if name.startswith("tenant ") else name.partition(" ")[0]
    signs_in = name.endswith(f" {_SIGN_IN}")
    what = "signs in or opens links" if signs_in else "changes things"
    quota = "sign_ins_per_s" if signs_in else "writes_per_s"
    return Problem(
        429,
        "rate_limited",
        f"this {owner} {what} more often than {rate:g} times per second",
        retryable=True,
        headers={"retry-after": str(max(math.ceil(wait_s), 1))},
        members={"quota": {"name": quota, "of": owner, "limit": rate, "used": rate}},
    )
