"""The list of bad captures, filled by the modules `bad_*`: how to write each, and which codes are to be
found."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True)
class BadCapture:
    """How to write a bad capture, and which codes are to be found in it."""

    write: Callable[[Path], None]
    codes: tuple[str, ...]
    is_error: bool


CAPTURES: dict[str, BadCapture] = {}


def bad(name: str, *codes: str, error: bool = False) -> Callable[[Callable[[Path], None]], Callable]:
    """Register a bad capture."""

    def register(write: Callable[[Path], None]) -> Callable[[Path], None]:
        assert name not in CAPTURES
        CAPTURES[name] = BadCapture(write, codes, error)
        return write

    return register
