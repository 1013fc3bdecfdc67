"""Exceptions of the method that are meant for users."""

import signal


class FlashCacheError(Exception):
    """A problem that a user can fix; the message says what was found and what to do."""


class ConfigError(FlashCacheError, ValueError):
    """A setting is out of range or contradicts another one."""


class TrainingError(FlashCacheError):
    """Training cannot continue (non-finite losses, an empty scene)."""


class ProcessEndedError(FlashCacheError):
    """A process that computed a part of each step ended before it answered."""

    def __init__(self, code: int) -> None:
        """`code` is the exit code, negative for the number of a signal."""
        self.was_killed = code == -signal.SIGKILL
        how = f"by signal {-code} ({signal.strsignal(-code)})" if code < 0 else f"with exit code {code}"
        if self.was_killed:
            how += "; the system does this to processes when memory is short"
        super().__init__(
            f"a process that computed a part of each step ended {how}; with --threads 1 there are no others"
        )
