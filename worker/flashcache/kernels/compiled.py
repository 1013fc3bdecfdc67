"""Python loops as machine code that releases the interpreter lock."""

import hashlib
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numba

_OPTIONS = {"nogil": True, "error_model": "numpy", "boundscheck": False}


def compiled(function: Callable[..., Any], **options: Any) -> Callable[..., Any]:
    """Return `function` compiled, from numba's cache folder where there is a writable one.

    numba looks at NUMBA_CACHE_DIR, beside the function's file, and in the user's cache folder, and raises
    where it can write nowhere; then the code is compiled anew in each process (a few seconds). `options` are
    those of `numba.njit`.
    """
    try:
        return numba.njit(cache=True, **_OPTIONS, **options)(function)
    except RuntimeError:
        return numba.njit(**_OPTIONS, **options)(function)


def inlined(function: Callable[..., Any], **options: Any) -> Callable[..., Any]:
    """Return a function for the use of compiled ones, which is kept with them and not by itself."""
    return numba.njit(**_OPTIONS, **options)(function)


def digest_of(*modules: ModuleType) -> int:
    """Return a number that changes with the source of `modules`.

    numba compiles a cached function again when its own file changes, but not when the functions do that it
    calls from other files. A compiled function that has this number in its closure is compiled again then.
    """
    content = hashlib.sha256()
    for module in modules:
        content.update(Path(str(module.__file__)).read_bytes())
    return int.from_bytes(content.digest()[:6], "big")
