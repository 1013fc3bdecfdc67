"""Checked reading of what people write: every problem is reported with its place, none stops the reading.

A place is a JSON pointer into the document ("/assets/1/material").
"""

import difflib
import math
from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from typing import Any, TypeVar

T = TypeVar("T")
Check = Callable[[Any], T]
"""Returns the value as it is used, or raises ValueError with what was expected and found."""

_SHOWN = 40


@dataclass(frozen=True, slots=True)
class Problem:
    """One thing that is wrong with a document."""

    pointer: str
    message: str


@dataclass(slots=True)
class Problems:
    """Collects what is wrong with one document."""

    found: list[Problem] = field(default_factory=list)

    def report(self, pointer: str, message: str) -> None:
        """Note one problem."""
        self.found.append(Problem(pointer, message))


class Members:
    """The members of one mapping. A value that cannot be used is reported, and its default returned."""

    def __init__(self, value: Any, pointer: str, problems: Problems) -> None:
        self.pointer = pointer
        self.problems = problems
        self._known: set[str] = set()
        self.is_mapping = isinstance(value, dict)
        self._values: dict[str, Any] = value if isinstance(value, dict) else {}
        if not self.is_mapping:
            problems.report(pointer, f"a mapping is expected, not {shown(value)}")

    def at(self, name: str) -> str:
        """Return the place of a member."""
        return f"{self.pointer}/{name}"

    def has(self, name: str) -> bool:
        """Return whether a member is there and not empty."""
        self._known.add(name)
        return self._values.get(name) is not None

    def raw(self, name: str) -> Any:
        """Return a member as it is; None where it is not there."""
        self._known.add(name)
        return self._values.get(name)

    def take(self, name: str, check: Check[T], default: T) -> T:
        """Return a member that `check` accepts, else the default."""
        if not self.has(name):
            return default
        try:
            return check(self._values[name])
        except ValueError as error:
            self.problems.report(self.at(name), f"{name}: {error}")
            return default

    def require(self, name: str, check: Check[T], default: T) -> T:
        """Return a member as `take` does; that it is not there is a problem."""
        if self.is_mapping and not self.has(name):
            self.problems.report(self.pointer, f"{name} is missing")
        return self.take(name, check, default)

    def close(self) -> None:
        """Report members that nobody asked for."""
        for name in self._values:
            if name not in self._known:
                near = difflib.get_close_matches(str(name), self._known, 1)
                hint = f"did you mean {near[0]!r}?" if near else f"known are {', '.join(sorted(self._known))}"
                self.problems.report(self.at(str(name)), f"there is no {shown(name)} here; {hint}")


def shown(value: Any) -> str:
    """Return a value as it is quoted in a message."""
    text = repr(value)
    return text if len(text) <= _SHOWN else text[: _SHOWN - 3] + "..."


def text(max_length: int = 4096) -> Check[str]:
    """Accept text without control characters that is not empty."""

    def check(value: Any) -> str:
        if not isinstance(value, str) or not value or any(ord(letter) < 32 for letter in value):
            raise ValueError(f"text is expected, not {shown(value)}")
        if len(value) > max_length:
            raise ValueError(f"at most {max_length} characters are expected, not {len(value)}")
        return value

    return check


def number(low: float = -math.inf, high: float = math.inf) -> Check[float]:
    """Accept a finite number from `low` to `high`."""

    def check(value: Any) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise ValueError(f"a number is expected, not {shown(value)}")
        if not low <= value <= high:
            raise ValueError(f"{value} is not {_range(low, high)}")
        return float(value)

    return check


def whole(low: int, high: int) -> Check[int]:
    """Accept a whole number from `low` to `high`."""

    def check(value: Any) -> int:
        found = number(low, high)(value)
        if not found.is_integer():
            raise ValueError(f"a whole number is expected, not {shown(value)}")
        return int(found)

    return check


def flag(value: Any) -> bool:
    """Accept true and false."""
    if not isinstance(value, bool):
        raise ValueError(f"true or false is expected, not {shown(value)}")
    return value


def choice(choices: Collection[str]) -> Check[str]:
    """Accept one of some words."""

    def check(value: Any) -> str:
        if value not in choices:
            raise ValueError(f"one of {', '.join(choices)} is expected, not {shown(value)}")
        return str(value)

    return check


def list_of(item: Check[T], min_length: int = 1, max_length: int = 10_000) -> Check[tuple[T, ...]]:
    """Accept a list of items that `item` accepts."""

    def check(value: Any) -> tuple[T, ...]:
        if not isinstance(value, list) or not min_length <= len(value) <= max_length:
            expected = min_length if min_length == max_length else f"{min_length} to {max_length}"
            raise ValueError(f"a list of {expected} entries is expected, not {shown(value)}")
        return tuple(item(each) for each in value)

    return check


def colour(low: float, high: float) -> Check[tuple[float, float, float]]:
    """Accept three numbers for red, green and blue."""

    def check(value: Any) -> tuple[float, float, float]:
        red, green, blue = list_of(number(low, high), 3, 3)(value)
        return red, green, blue

    return check


def _range(low: float, high: float) -> str:
    if math.isinf(high):
        return f"{low:g} or more"
    return f"up to {high:g}" if math.isinf(low) else f"from {low:g} to {high:g}"
