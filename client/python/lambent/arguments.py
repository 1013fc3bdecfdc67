"""Arguments of `Client`, checked before anything is sent.

Each function returns the value, or raises UsageProblemError `client.argument` with the argument's name, what
was given, and what to give.
"""

import math
import operator
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from lambent.errors import UsageProblemError

F = TypeVar("F")

_ID = re.compile(r"[A-Za-z0-9_\-]{1,128}")
_SHOWN = 40


def identifier(value: object, name: str) -> str:
    """Return an id of the server; one that was empty, or an object, would ask for something else."""
    if not isinstance(value, str):
        own = getattr(value, "id", None)
        raise _refused(name, value, f"give its id, {own!r}" if isinstance(own, str) else "give an id")
    if not _ID.fullmatch(value):
        raise _refused(name, value, "give an id as the server gives it, of letters, digits, _ and -")
    return value


def identifiers(values: object, name: str) -> list[str]:
    """Return a list of ids; a single id is not one, although it is a sequence of letters."""
    return [identifier(each, f"an entry of {name}") for each in _entries(values, name, "give a list of ids")]


def text(value: object, name: str) -> str:
    """Return a string."""
    return instance(value, str, name, "give a string")


def text_list(value: object, name: str) -> list[str]:
    """Return a list of strings; a single string is not one, although it is a sequence of strings."""
    return [text(each, f"an entry of {name}") for each in _entries(value, name, "give a list of strings")]


def _entries(value: object, name: str, advice: str) -> Sequence[Any]:
    if isinstance(value, str) or not isinstance(value, Sequence):
        raise _refused(name, value, advice)
    return value


def file_path(value: object, name: str) -> Path:
    """Return the path that a string or a path object names."""
    if not isinstance(value, (str, os.PathLike)) or not str(value):
        raise _refused(name, value, "give the path as a string or a Path")
    return Path(value)


def whole(value: object, name: str, least: int | None = None) -> int:
    """Return a whole number, `least` at least."""
    advice = "give a whole number" + ("" if least is None else f" of {least} or more")
    try:
        if isinstance(value, bool):
            raise TypeError
        number = operator.index(value)  # type: ignore[arg-type]
    except TypeError as error:
        raise _refused(name, value, advice) from error
    if least is not None and number < least:
        raise _refused(name, value, advice)
    return number


def seconds(value: object, name: str) -> float:
    """Return a finite number of seconds, 0 or more."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise _refused(name, value, "give a number of seconds")
    if not (math.isfinite(value) and value >= 0.0):
        raise _refused(name, value, "give a finite number of seconds, 0 or more")
    return value


def texts(value: object, name: str) -> dict[str, str]:
    """Return a mapping of strings to strings; None stands for an empty one."""
    given = {} if value is None else value
    if not isinstance(given, Mapping):
        raise _refused(name, value, "give a mapping of strings to strings")
    for key, entry in given.items():
        if not isinstance(key, str) or not isinstance(entry, str):
            raise _refused(f"{name}[{key!r}]", entry, "give names and values as strings, numbers too")
    return dict(given)


def mapping(value: object, name: str) -> dict[str, Any]:
    """Return a mapping with string keys."""
    if not isinstance(value, Mapping) or not all(isinstance(key, str) for key in value):
        raise _refused(name, value, "give a mapping")
    return dict(value)


def function(value: F, name: str) -> F:
    """Return a function, or whatever else can be called."""
    if not callable(value):
        raise _refused(name, value, "give a function")
    return value


def instance(value: object, kind: type[F], name: str, advice: str) -> F:
    """Return a value of a class."""
    if not isinstance(value, kind):
        raise _refused(name, value, advice)
    return value


def _refused(name: str, value: object, advice: str) -> UsageProblemError:
    shown = repr(value)
    shown = shown if len(shown) <= _SHOWN else shown[: _SHOWN - 3] + "..."
    kind = "" if value is None else f"{type(value).__name__} "
    return UsageProblemError("client.argument", f"{name} cannot be {kind}{shown}", advice)
