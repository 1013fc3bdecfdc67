"""Exceptions of the method that are meant for users."""

import signal
from typing import Any


class FlashCacheError(Exception):
    """A problem that a user can fix; the message says what was found and what to do."""


class ConfigError(FlashCacheError, ValueError):
    """A setting is out of range or contradicts another one."""


class TrainingError(FlashCacheError):
    """Training cannot continue (non-finite losses, an empty scene)."""


class RankLostError(FlashCacheError):
    """A rank cannot continue, because another one is gone or does not answer."""


class RanksDifferError(FlashCacheError):
    """Ranks have other values than each other, which they must not: a device computes wrongly."""

    def __init__(self, step: int) -> None:
        self.step = step
        super().__init__(
            f"the ranks' models differ after step {step}; they are the same on sound devices of one kind"
        )

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.step,)


class ProcessEndedError(FlashCacheError):
    """A process that computed a part of each step ended before it answered."""

    def __init__(self, code: int, of_ranks: int = 0) -> None:
        """`code` is the exit code, negative for the number of a signal; `of_ranks` counts losses of ranks."""
        self.was_killed = code == -signal.SIGKILL
        how = f"by signal {-code} ({signal.strsignal(-code)})" if code < 0 else f"with exit code {code}"
        if self.was_killed:
            how += "; the system does this to processes when memory is short"
        others = f"it was lost {of_ranks} times" if of_ranks else "with --threads 1 there are no others"
        super().__init__(f"a process that computed a part of each step ended {how}; {others}")
