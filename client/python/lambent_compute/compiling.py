"""Python loops as machine code (numba) that releases the interpreter lock.

numba compiles a function that it has kept on disk again when that function's own file has changed, but not
when a function or a number has that it takes from another file. So what is kept here is stamped with all
that a function reaches.
"""

import hashlib
import inspect
from collections.abc import Callable, Iterator
from types import CodeType, ModuleType
from typing import Any

import numba
import numpy as np
from numba.core.caching import IndexDataCacheFile
from numba.core.dispatcher import Dispatcher

REORDERED = frozenset({"contract", "reassoc", "nsz"})
"""Sums may be reordered, and a product and a sum may be one operation. Numbers that are none, and infinite
ones, keep their meaning: clamping must catch them before they become an address."""
CONTRACTED = frozenset({"contract"})
"""For steps that undo each other's rounding and may not change places."""

_OPTIONS = {"nogil": True, "error_model": "numpy", "boundscheck": False}

Decorator = Callable[[Callable[..., Any]], Any]


def inlined(fastmath: frozenset[str] | bool = REORDERED) -> Decorator:
    """Return a decorator for functions that only compiled ones call; they are kept inside these.

    `fastmath` are LLVM's liberties with numbers; False allows none.
    """
    return numba.njit(fastmath=_liberties(fastmath), **_OPTIONS)


def compiled(fastmath: frozenset[str] | bool = REORDERED) -> Decorator:
    """Return a decorator for functions that Python calls; what is compiled is kept where numba finds a place.

    numba looks at NUMBA_CACHE_DIR, beside the function's file, and in the user's cache folder. Where it can
    write nowhere the code is compiled anew in each process (a few seconds).
    """

    def decorate(function: Callable[..., Any]) -> Any:
        plain = numba.njit(fastmath=_liberties(fastmath), **_OPTIONS)(function)
        try:
            kept = numba.njit(cache=True, fastmath=_liberties(fastmath), **_OPTIONS)(function)
        except RuntimeError:  # There is no writable folder.
            return plain
        return kept if _stamped(kept) else plain

    return decorate


def _liberties(fastmath: frozenset[str] | bool) -> set[str] | bool:
    return fastmath if isinstance(fastmath, bool) else set(fastmath)


class _KeptFiles(IndexDataCacheFile):
    """Files that no other code is ever written to.

    numba names them by function and number. Two variants of a closure, or two signatures that two processes
    compile at once, then write to the same name, and what one index promises is the other's code.
    """

    def __init__(self, plain: IndexDataCacheFile, digest: str) -> None:
        """`plain` is numba's own choice of folder and name, `digest` that of the code."""
        name = f"{plain._index_name.removesuffix('.nbi')}-{digest[:16]}"
        super().__init__(plain._cache_path, name, (*plain._source_stamp, digest))
        self._name = name

    def save(self, key: Any, data: Any) -> None:
        """Keep the code of a signature; the index names it only when it is there."""
        file = f"{self._name}.{hashlib.sha256(repr(key).encode()).hexdigest()[:16]}.nbc"
        self._save_data(file, data)
        self._save_index({**self._load_index(), key: file})


def _stamped(dispatcher: Any) -> bool:
    """Let what is kept of a function count only while all that it reaches is the same; False if it cannot be.

    numba offers no way to say so, and this reaches into it: a version without these names keeps nothing.
    """
    try:
        cache = dispatcher._cache
        cache._cache_file = _KeptFiles(cache._cache_file, digest_of(dispatcher))
    except (AttributeError, TypeError):
        return False
    return True


def digest_of(dispatcher: Any) -> str:
    """Return a text that changes with a compiled function, with what it calls, and with their constants."""
    content = hashlib.sha256()
    for part in _reached(dispatcher, set()):
        content.update(part.encode())
    return content.hexdigest()


def _reached(value: Any, seen: set[int]) -> Iterator[str]:
    """Yield what tells apart the different meanings of a global of a compiled function."""
    if isinstance(value, Dispatcher):
        if id(value) in seen:
            return
        seen.add(id(value))
        function = value.py_func
        yield function.__qualname__
        yield from (f"{name} {_text(option)}" for name, option in sorted(value.targetoptions.items()))
        yield from _code(function.__code__)
        variables = inspect.getclosurevars(function)
        names = _names(function.__code__)
        for name, one in sorted({**variables.globals, **variables.nonlocals}.items()):
            yield name
            if isinstance(one, ModuleType):
                for attribute in names:
                    if hasattr(one, attribute):
                        yield from _reached(getattr(one, attribute), seen)
            else:
                yield from _reached(one, seen)
    elif inspect.isclass(value) or callable(value):
        # An intrinsic, a named tuple, or a function of a library.
        module = inspect.getmodule(value)
        own = module is not None and module.__name__.partition(".")[0].startswith(("lambent", "flashcache"))
        yield (
            inspect.getsource(module) if own and module is not None else repr(getattr(value, "__name__", ""))
        )
    else:
        yield _text(value)


def _text(value: Any) -> str:
    """Return a text of a constant that is the same in every process."""
    if isinstance(value, np.ndarray):
        return f"{value.dtype} {value.shape} {value.tobytes().hex()}"
    return repr(sorted(value) if isinstance(value, set | frozenset) else value)


def _names(code: CodeType) -> list[str]:
    return sorted({*code.co_names})


def _code(code: CodeType) -> Iterator[str]:
    yield code.co_code.hex()
    yield repr([constant for constant in code.co_consts if not isinstance(constant, CodeType)])
    yield repr((code.co_names, code.co_varnames))
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _code(constant)
