"""Arguments of the public functions, checked where they come in.

Each function returns the value as the rest of the package wants it, or raises SettingError `relight.argument`
(or the error that the caller chooses) with the argument's name, what is expected, and what was given.
"""

import math
import operator
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from lambent_core.errors import RelightError, SettingError
from numpy.typing import NDArray

from lambent_relight.validation import shown

Kind = TypeVar("Kind")
Refusal = Callable[[str, str], RelightError]
"""Makes an error of what was found and of what to do."""


def refusal(code: str = "relight.argument", kind: type[RelightError] = SettingError) -> Refusal:
    """Return what makes errors of a kind with a code."""
    return lambda what, advice: kind(code, what, advice)


REFUSAL = refusal()
"""What is raised where a caller names no other error."""


def instance(value: object, kind: type[Kind], name: str, advice: str, *, refuse: Refusal = REFUSAL) -> Kind:
    """Return `value`, which has to be of a class; `advice` says how to get one."""
    if not isinstance(value, kind):
        raise refuse(f"{name} is not a {kind.__name__} but {_described(value)}", advice)
    return value


def file_path(value: object, name: str, *, refuse: Refusal = REFUSAL) -> Path:
    """Return the path that a string or a path object names."""
    if not isinstance(value, (str, os.PathLike)) or isinstance(os.fspath(value), bytes):
        raise refuse(f"{name} is not a path but {_described(value)}", "give a string or a Path")
    return Path(value)


def number(
    value: object,
    name: str,
    *,
    above: float = -math.inf,
    below: float = math.inf,
    refuse: Refusal = REFUSAL,
) -> float:
    """Return a finite number between two exclusive bounds."""
    if isinstance(value, (bool, np.bool_, str, bytes)) or not is_single(value):
        raise refuse(f"{name} is not a number but {_described(value)}", "give one number")
    try:
        result = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError) as error:
        raise refuse(f"{name} is not a number but {_described(value)}", "give one number") from error
    if not (math.isfinite(result) and above < result < below):
        bounds = [f"above {above:g}"] if above > -math.inf else []
        bounds += [f"below {below:g}"] if below < math.inf else []
        raise refuse(f"{name} is {result:g}", f"give a finite number {' and '.join(bounds)}".strip())
    return result


def whole(value: object, name: str, least: int, most: int | None = None, *, refuse: Refusal = REFUSAL) -> int:
    """Return a whole number from `least` to `most`, both included."""
    expected = f"from {least}" + ("" if most is None else f" to {most}")
    advice = f"give a whole number {expected}"
    try:
        if isinstance(value, (bool, np.bool_)):
            raise TypeError
        result = operator.index(value)  # type: ignore[arg-type]
    except TypeError as error:
        raise refuse(f"{name} is not a whole number but {_described(value)}", advice) from error
    if result < least or (most is not None and result > most):
        raise refuse(f"{name} is {result}", advice)
    return result


def is_single(value: object) -> bool:
    """Return whether a value is neither an array nor a list of others."""
    try:
        return np.ndim(value) == 0  # type: ignore[arg-type]
    except ValueError:  # a list whose rows differ in length
        return False


def colour(value: object, name: str, *, refuse: Refusal = REFUSAL) -> tuple[float, float, float]:
    """Return three finite numbers; a single one, also in a list, stands for all of them."""
    given = array(value, () if is_single(value) else (None,), name, refuse=refuse)
    if given.size not in (1, 3):
        raise refuse(f"{name} has {given.size} entries", "give one or three numbers")
    red, green, blue = np.broadcast_to(given, (3,)).tolist()
    return red, green, blue


def array(
    value: object, shape: tuple[int | None, ...], name: str, *, refuse: Refusal = REFUSAL
) -> NDArray[np.float64]:
    """Return finite numbers of a shape, in which None stands for any size, as a new array."""
    words = "[" + ", ".join("n" if size is None else str(size) for size in shape) + "]"
    advice = f"give finite numbers of shape {words}"
    try:
        result = np.array(value, np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise refuse(f"{name} is not an array of numbers but {_described(value)}", advice) from error
    fits = len(result.shape) == len(shape) and all(
        size in (None, given) for size, given in zip(shape, result.shape, strict=True)
    )
    if not fits:
        raise refuse(f"{name} has shape {list(result.shape)}", advice)
    if not np.isfinite(result).all():
        raise refuse(f"{name} holds NaN or infinite values", advice)
    return result


def _described(value: Any) -> str:
    """Return a value in a few words: an array by its shape, others by their class and a short `repr`."""
    if isinstance(value, np.ndarray):
        return f"an array {value.dtype} of shape {list(value.shape)}"
    return "None" if value is None else f"{type(value).__name__} {shown(value)}"
