"""Exceptions of the method that are meant for the person who configured it."""


class FlashCacheError(Exception):
    """Something a user can mend; the message says what was found and what to do."""


class ConfigError(FlashCacheError, ValueError):
    """A setting is out of range or contradicts another one."""


class TrainingError(FlashCacheError):
    """Training cannot go on (non-finite losses, an empty scene)."""
