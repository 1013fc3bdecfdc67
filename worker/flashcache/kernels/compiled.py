"""Python loops as machine code that releases the interpreter lock."""

from collections.abc import Callable
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
