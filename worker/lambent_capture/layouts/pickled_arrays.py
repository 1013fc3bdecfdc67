"""Reads numpy arrays, lists and strings from pickle files without executing anything in the file.

A pickle is a program for a small stack machine. Python's reader runs it here with only those instructions
that make up plain data, and every function a program may name is a stand-in that builds arrays of numbers.
"""

import io
import pickle
import pickletools
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

MAX_BYTES = 2**20
MAX_VALUES, MAX_CALLS = 100_000, 64
"""A camera needs six calls; each may copy as many bytes as the file has."""

_ARRAY_MODULES = (
    "numpy.core.multiarray",
    "numpy._core.multiarray",
    "numpy.core.numeric",
    "numpy._core.numeric",
)
_KINDS = ("f4", "f8", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8")
_INSTRUCTIONS = """
    PROTO FRAME STOP MARK NONE NEWTRUE NEWFALSE INT BININT BININT1 BININT2 LONG LONG1 LONG4 FLOAT BINFLOAT
    STRING BINSTRING SHORT_BINSTRING BINBYTES SHORT_BINBYTES BINBYTES8 BYTEARRAY8 UNICODE BINUNICODE
    SHORT_BINUNICODE BINUNICODE8 EMPTY_LIST EMPTY_TUPLE LIST TUPLE TUPLE1 TUPLE2 TUPLE3 APPEND APPENDS PUT
    BINPUT LONG_BINPUT MEMOIZE GET BINGET LONG_BINGET GLOBAL STACK_GLOBAL REDUCE BUILD
"""


class PickleRefusedError(Exception):
    """The file is not a pickle of numbers, lists and texts; the text says what was found."""


def read_pickled_data(path: Path) -> Any:
    """Return the contents of a pickle: nested lists and tuples of numbers, texts, bytes and numpy arrays.

    Raises `PickleRefusedError` for a file above 1 MiB, one that is damaged, and one that holds anything else;
    nothing in the file is ever executed. Raises `OSError` where the file cannot be opened.
    """
    with path.open("rb") as file:
        data = file.read(MAX_BYTES + 1)
    if len(data) > MAX_BYTES:
        raise PickleRefusedError(f"has more than {MAX_BYTES} bytes")
    try:
        return _plain(_Reader(io.BytesIO(data)).load(), iter(range(MAX_VALUES)))
    except PickleRefusedError:
        raise
    except Exception as error:  # the library and numpy raise many kinds for bytes that make no sense
        raise PickleRefusedError(f"is damaged ({type(error).__name__})") from error


class _Kind:
    """Stands for numpy's dtype: an element type such as "f8" and the byte order."""

    def __init__(self, code: Any, *_: Any) -> None:
        if code not in _KINDS:
            raise PickleRefusedError("holds arrays of something that is not a number")
        self.element = np.dtype(code)

    def build(self, _version: Any, order: Any, *rest: Any) -> None:
        # (version, byte order, sub-array, names, fields, ...): a plain number has none of the latter.
        if order not in ("<", ">", "|") or any(part is not None for part in rest[:3]):
            raise PickleRefusedError("holds arrays of something that is not a number")
        self.element = self.element.newbyteorder(order)


class _Array:
    """Stands for an array whose contents may still be to come."""

    def __init__(self, *_: Any) -> None:
        self.value: np.ndarray | None = None

    def build(self, _version: Any, shape: Any, kind: Any, is_fortran: Any, data: Any) -> None:
        self.value = _array(data, kind, shape, "F" if is_fortran else "C")


def _array(data: Any, kind: Any, shape: Any = (), order: Any = "C") -> np.ndarray:
    if not isinstance(kind, _Kind) or not isinstance(data, bytes):
        raise PickleRefusedError("holds arrays of something that is not a number")
    return np.frombuffer(data, kind.element).reshape(shape, order=order)


def _encoded(text: Any, encoding: Any) -> bytes:
    if encoding != "latin1":
        raise PickleRefusedError("calls a function in a way that plain arrays do not need")
    return str(text).encode("latin1")


_STAND_INS: dict[tuple[str, str], Callable[..., Any]] = {
    ("numpy", "ndarray"): _Array,
    ("numpy", "dtype"): _Kind,
    ("_codecs", "encode"): _encoded,
}
for _module in _ARRAY_MODULES:
    _STAND_INS[_module, "_reconstruct"] = _Array
    _STAND_INS[_module, "_frombuffer"] = _array
    _STAND_INS[_module, "scalar"] = lambda kind, data: _array(data, kind)


class _Instructions(dict):
    """What is done for each instruction; others than these are refused."""

    def __missing__(self, code: int) -> None:
        name = vars(pickletools)["code2op"][chr(code)].name
        raise PickleRefusedError(f"holds the instruction {name}, which plain data does not need")


# The library's reader in C sets aside as much memory as an instruction names; the one in Python does not.
_PYTHONS: Any = pickle._Unpickler
"""Python's own reader, whose methods no stub has."""


class _Reader(_PYTHONS):  # type: ignore[misc]  # a base without types
    """Python's own reader with fewer instructions and no functions but the stand-ins."""

    num_calls = 0

    def find_class(self, module: Any, name: Any) -> Any:
        stand_in = _STAND_INS.get((str(module), str(name)))
        if stand_in is None:
            raise PickleRefusedError(f"asks for {str(module)[:60]}.{str(name)[:60]}, which is not run")
        return stand_in

    def _call(self) -> None:
        self.num_calls += 1
        if self.num_calls > MAX_CALLS:
            raise PickleRefusedError(f"holds more than {MAX_CALLS} calls, for arrays that no camera has")
        self.load_reduce()

    def _build(self) -> None:
        state = self.stack.pop()
        target = self.stack[-1]
        if not isinstance(target, _Array | _Kind) or not isinstance(state, tuple):
            raise PickleRefusedError("sets the state of something that is not an array")
        target.build(*state)

    def _bytes(self) -> None:
        # The library makes room for as many bytes as are announced before it looks for them.
        self.append(self.read(int.from_bytes(self.read(8), "little")))

    _known = (getattr(pickle, name)[0] for name in _INSTRUCTIONS.split())
    dispatch = _Instructions((code, pickle._Unpickler.dispatch[code]) for code in _known)
    dispatch |= {pickle.REDUCE[0]: _call, pickle.BUILD[0]: _build, pickle.BYTEARRAY8[0]: _bytes}


def _plain(value: Any, budget: Iterator[int], depth: int = 0) -> Any:
    """Return a result without stand-ins; what is named several times counts several times."""
    if depth > 8 or next(budget, None) is None:
        raise PickleRefusedError(f"is nested too deeply or holds more than {MAX_VALUES} values")
    if isinstance(value, _Array):
        value = value.value
        if value is None:
            raise PickleRefusedError("holds an array without contents")
    if isinstance(value, list | tuple):
        return type(value)(_plain(item, budget, depth + 1) for item in value)
    if not isinstance(value, int | float | str | bytes | np.ndarray | None):
        raise PickleRefusedError("holds something that is not data")
    return value
