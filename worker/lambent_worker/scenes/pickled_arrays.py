"""Reads numpy arrays, lists and strings from pickle files without executing anything in the file.

A pickle is a program for a small stack machine, and the usual reader calls whatever function it names. This
one steps through the instructions itself, knows only those that make up plain data, and where the program
calls numpy's functions for arrays it notes their arguments instead and builds the array from the bytes.
"""

import pickletools
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

MAX_BYTES = 2**20
MAX_STEPS = 200_000

_ARRAY_MODULES = (
    "numpy.core.multiarray",
    "numpy._core.multiarray",
    "numpy.core.numeric",
    "numpy._core.numeric",
)
_KINDS = ("f4", "f8", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8")
_MARK = object()


class PickleRefusedError(Exception):
    """The file is no pickle of numbers, lists and texts; the text says what was found."""


@dataclass(frozen=True, slots=True)
class _Function:
    """Stands for one of the few functions that are understood; never called."""

    name: str


@dataclass(slots=True)
class _Kind:
    """Element type of an array: a code such as "f8" and the byte order."""

    code: str
    order: str = "<"


@dataclass(slots=True)
class _Array:
    """An array whose contents may still be to come."""

    value: np.ndarray | None = None


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
        return _plain(_Machine().run(data), depth=0)
    except PickleRefusedError:
        raise
    except Exception as error:  # the library and numpy raise many kinds for bytes that make no sense
        raise PickleRefusedError(f"is damaged ({type(error).__name__})") from error


class _Machine:
    """The stack machine: a stack of values and a table of values to be used again."""

    def __init__(self) -> None:
        self.stack: list[Any] = []
        self.memo: dict[int, Any] = {}

    def run(self, data: bytes) -> Any:
        for count, (instruction, argument, _) in enumerate(pickletools.genops(data)):
            if count > MAX_STEPS:
                raise PickleRefusedError("has too many instructions")
            if instruction.name == "STOP":
                return self.stack[-1]
            self._step(instruction.name, argument)
        raise PickleRefusedError("ends too early")

    def _step(self, name: str, argument: Any) -> None:
        stack = self.stack
        if name in ("PROTO", "FRAME"):
            return
        if name in _LITERALS:
            stack.append(argument)
        elif name in _CONSTANTS:
            stack.append(_CONSTANTS[name]())
        elif name == "MARK":
            stack.append(_MARK)
        elif name in ("TUPLE1", "TUPLE2", "TUPLE3"):
            stack.append(tuple(self._take(int(name[-1]))))
        elif name in ("TUPLE", "LIST"):
            items = self._since_mark()
            stack.append(tuple(items) if name == "TUPLE" else items)
        elif name in ("APPEND", "APPENDS"):
            items = self._take(1) if name == "APPEND" else self._since_mark()
            if not isinstance(stack[-1], list):
                raise PickleRefusedError("appends to something that is no list")
            stack[-1].extend(items)
        elif name in ("PUT", "BINPUT", "LONG_BINPUT"):
            self.memo[int(argument)] = stack[-1]
        elif name == "MEMOIZE":
            self.memo[len(self.memo)] = stack[-1]
        elif name in ("GET", "BINGET", "LONG_BINGET"):
            stack.append(self.memo[int(argument)])
        elif name in ("GLOBAL", "STACK_GLOBAL"):
            module, function = argument.split(" ", 1) if name == "GLOBAL" else self._take(2)
            stack.append(_known_function(module, function))
        elif name == "REDUCE":
            function, arguments = self._take(2)
            stack.append(_called(function, arguments))
        elif name == "BUILD":
            (state,) = self._take(1)
            _build(stack[-1], state)
        else:
            raise PickleRefusedError(f"holds the instruction {name}, which plain data does not need")

    def _take(self, count: int) -> list[Any]:
        if count > len(self.stack) or any(item is _MARK for item in self.stack[-count:]):
            raise PickleRefusedError("takes more from its stack than is there")
        items = self.stack[-count:]
        del self.stack[-count:]
        return items

    def _since_mark(self) -> list[Any]:
        place = next((i for i in range(len(self.stack) - 1, -1, -1) if self.stack[i] is _MARK), None)
        if place is None:
            raise PickleRefusedError("closes a list that was not opened")
        items = self.stack[place + 1 :]
        del self.stack[place:]
        return items


_LITERALS = frozenset(
    [
        "INT",
        "BININT",
        "BININT1",
        "BININT2",
        "LONG",
        "LONG1",
        "LONG4",
        "FLOAT",
        "BINFLOAT",
        "STRING",
        "BINSTRING",
        "SHORT_BINSTRING",
        "BINBYTES",
        "SHORT_BINBYTES",
        "BINBYTES8",
        "BYTEARRAY8",
        "UNICODE",
        "BINUNICODE",
        "SHORT_BINUNICODE",
        "BINUNICODE8",
    ]
)
_CONSTANTS = {
    "NONE": lambda: None,
    "NEWTRUE": lambda: True,
    "NEWFALSE": lambda: False,
    "EMPTY_LIST": list,
    "EMPTY_TUPLE": tuple,
}


def _known_function(module: Any, name: Any) -> _Function:
    if module in _ARRAY_MODULES and name in ("_reconstruct", "_frombuffer", "scalar"):
        return _Function(name)
    if module == "numpy" and name in ("ndarray", "dtype"):
        return _Function(name)
    if module == "_codecs" and name == "encode":
        return _Function(name)
    raise PickleRefusedError(f"asks for {str(module)[:60]}.{str(name)[:60]}, which is not run")


def _called(function: Any, arguments: Any) -> Any:
    """Return the result that numpy's function would have given, from its arguments alone."""
    name = function.name if isinstance(function, _Function) else ""
    if not isinstance(arguments, tuple):
        raise PickleRefusedError("calls a function without a list of arguments")
    if name == "dtype" and arguments and arguments[0] in _KINDS:
        return _Kind(arguments[0])
    if name == "encode" and len(arguments) == 2 and arguments[1] == "latin1":
        return str(arguments[0]).encode("latin1")
    if name == "_reconstruct" and arguments and arguments[0] == _Function("ndarray"):
        return _Array()
    if name == "_frombuffer" and len(arguments) == 4:
        data, kind, shape, order = arguments
        return _Array(_array(shape, kind, order == "F", data))
    if name == "scalar" and len(arguments) == 2:
        return _Array(_array((), arguments[0], False, arguments[1]))
    raise PickleRefusedError("calls a function in a way that plain arrays do not need")


def _build(target: Any, state: Any) -> None:
    if isinstance(target, _Kind) and isinstance(state, tuple) and len(state) >= 2:
        # (version, byte order, sub-array, names, fields, ...): a plain number has none of the latter.
        if state[1] not in ("<", ">", "|") or any(part is not None for part in state[2:5]):
            raise PickleRefusedError("holds arrays of something that is no number")
        target.order = state[1]
    elif isinstance(target, _Array) and isinstance(state, tuple) and len(state) == 5:
        _, shape, kind, is_fortran, data = state
        target.value = _array(shape, kind, bool(is_fortran), data)
    else:
        raise PickleRefusedError("sets the state of something that is no array")


def _array(shape: Any, kind: Any, is_fortran: bool, data: Any) -> np.ndarray:
    sizes = shape if isinstance(shape, tuple) else (shape,)
    if not isinstance(kind, _Kind) or not isinstance(data, bytes | bytearray):
        raise PickleRefusedError("holds arrays of something that is no number")
    if len(sizes) > 4 or not all(isinstance(size, int) and 0 <= size <= MAX_BYTES for size in sizes):
        raise PickleRefusedError("holds an array of an impossible shape")
    element = np.dtype(kind.code).newbyteorder(kind.order)
    count = int(np.prod(sizes, dtype=object)) if sizes else 1
    if count * element.itemsize != len(data):
        raise PickleRefusedError("holds an array whose shape and contents differ in size")
    values = np.frombuffer(bytes(data), dtype=element).astype(element.newbyteorder("="))
    return values.reshape(sizes, order="F" if is_fortran else "C")


def _plain(value: Any, depth: int) -> Any:
    """Return a result without our stand-ins; a list that contains itself is refused by its depth."""
    if depth > 8:
        raise PickleRefusedError("is nested too deeply")
    if isinstance(value, _Array):
        if value.value is None:
            raise PickleRefusedError("holds an array without contents")
        return value.value
    if isinstance(value, list | tuple):
        return type(value)(_plain(item, depth + 1) for item in value)
    if isinstance(value, _Kind | _Function) or value is _MARK:
        raise PickleRefusedError("holds something that is no data")
    return value
