"""Landlock: this process opens nothing outside a few folders, and those for reading only (Linux 5.13)."""

import ctypes
import errno
import os
from collections.abc import Iterable
from pathlib import Path

from lambent_sandbox import calls

_VERSION_FLAG = 1
_PATH_BENEATH = 1
_READ_FILE, _READ_DIR = 1 << 2, 1 << 3
# How many kinds of access to files each version of the interface knows.
_NUM_FILE_RIGHTS = {1: 13, 2: 14, 3: 15, 4: 15, 5: 16}
_NET_SINCE, _BIND_AND_CONNECT = 4, 0b11
_SCOPES_SINCE, _ABSTRACT_SOCKETS_AND_SIGNALS = 6, 0b11
_O_PATH = getattr(os, "O_PATH", 0)


class _Ruleset(ctypes.Structure):
    _fields_ = (("files", ctypes.c_uint64), ("net", ctypes.c_uint64), ("scopes", ctypes.c_uint64))


class _Beneath(ctypes.Structure):
    _pack_ = 1
    _layout_ = "ms"
    _fields_ = (("rights", ctypes.c_uint64), ("folder", ctypes.c_int32))


def install(readable: Iterable[Path]) -> str:
    """Let this process and its later threads read below `readable` only; return why that fails, or ""."""
    library = ctypes.CDLL(None, use_errno=True)
    version = library.syscall(calls.LANDLOCK_CREATE_RULESET, None, ctypes.c_size_t(0), _VERSION_FLAG)
    if version < 1:
        return os.strerror(ctypes.get_errno())
    handled = _Ruleset(files=(1 << _NUM_FILE_RIGHTS.get(version, 16)) - 1)
    size = 8
    if version >= _NET_SINCE:
        handled.net, size = _BIND_AND_CONNECT, 16
    if version >= _SCOPES_SINCE:
        handled.scopes, size = _ABSTRACT_SOCKETS_AND_SIGNALS, 24
    ruleset = library.syscall(calls.LANDLOCK_CREATE_RULESET, ctypes.byref(handled), ctypes.c_size_t(size), 0)
    if ruleset < 0:
        return os.strerror(ctypes.get_errno())
    try:
        for path in readable:
            _allow(library, ruleset, path)
        if library.syscall(calls.LANDLOCK_RESTRICT_SELF, ruleset, 0) != 0:
            return os.strerror(ctypes.get_errno())
    except OSError as error:
        return str(error)
    finally:
        os.close(ruleset)
    return ""


def _allow(library: ctypes.CDLL, ruleset: int, path: Path) -> None:
    """Allow reading below a folder, or a file; a path that does not exist needs no permission."""
    try:
        opened = os.open(path, _O_PATH | os.O_CLOEXEC)
    except OSError:
        return
    try:
        rights = _READ_FILE | _READ_DIR if path.is_dir() else _READ_FILE
        rule = _Beneath(rights=rights, folder=opened)
        if library.syscall(calls.LANDLOCK_ADD_RULE, ruleset, _PATH_BENEATH, ctypes.byref(rule), 0) != 0:
            number = ctypes.get_errno()
            raise OSError(number, f"{path}: {os.strerror(number)}, {errno.errorcode.get(number, '')}")
    finally:
        os.close(opened)
