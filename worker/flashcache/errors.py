"""Exceptions of the method that are meant for users."""


class FlashCacheError(Exception):
    """A problem that a user can fix; the message says what was found and what to do."""


class ConfigError(FlashCacheError, ValueError):
    """A setting is out of range or contradicts another one."""


class TrainingError(FlashCacheError):
    """Training cannot continue (non-finite losses, an empty scene)."""
