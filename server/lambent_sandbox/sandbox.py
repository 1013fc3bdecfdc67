"""The layers around a process that decodes untrusted files, from limits that every system has to filters.

`enter` is called by the process itself before it looks at the first byte. What a system does not offer is
named in the result; `REQUIRED` makes that an error.
"""

import ctypes
import importlib.util
import os
import resource
import sys
import sysconfig
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from lambent_sandbox import filters, landlock

REQUIRED: Final = "required"
AVAILABLE: Final = "available"
LIMITS: Final = "limits"
STRICTNESS: Final = (REQUIRED, AVAILABLE, LIMITS)
"""All layers, or nothing is decoded; those that this system has; limits of resources only."""

RLIMITS, PRIVILEGES, FILES, CALLS = "limits", "privileges", "files", "calls"

EXIT_REFUSED: Final = 3
"""Exit code of a process that was to have all layers, and has not."""
EXIT_BROKEN: Final = 4
"""Exit code of a process that cannot load what it reads files with."""

PACKAGES: Final = (
    "lambent_proto",
    "lambent_core",
    "lambent_sandbox",
    "lambent_compute",
    "lambent_capture",
)
"""What a process that reads pictures may import of ours."""

LIBRARIES: Final = (
    "cv2",
    "google.protobuf",
    "jaxtyping",
    "jinja2",
    "numba",
    "numpy",
    "OpenEXR",
    "PIL",
    "pillow_heif",
    "pydantic",
    "rawpy",
    "scipy",
    "skimage",
    "yaml",
)
"""What it may import of others, which may be elsewhere than this Python's own libraries."""

NOBODY: Final = 65534
_MIB = 2**20
_CAPABILITY_VERSION = 0x20080522
_READ_EVERYTHING = 1 << 2
"""CAP_DAC_READ_SEARCH: whoever runs this as root may give it captures of other users."""


class SandboxError(Exception):
    """A layer is missing that has to be there."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Limits:
    """What the process may use."""

    memory_bytes: int = 512 * _MIB
    """Address space."""
    cpu_s: int = 300
    """Processor time of all threads."""
    open_files: int = 64


@dataclass(frozen=True, slots=True)
class Layers:
    """What is in force, and what is not, with the reason."""

    in_force: tuple[str, ...]
    missing: dict[str, str]


def enter(
    limits: Limits, strictness: str, *, readable: Iterable[Path] | None = None, as_nobody: bool = False
) -> Layers:
    """Restrict this process for good; return what is in force, or raise `SandboxError` if it is too little.

    With `readable` it may open files below these paths, and those of its program, for reading; without it, it
    opens nothing at all any more. `as_nobody`: a process of root becomes one of a user without any files.
    `require_apart` has to hold for `readable`, where there is more than limits.
    """
    if strictness not in STRICTNESS:
        raise SandboxError(f"{strictness!r} is none of {', '.join(STRICTNESS)}")
    in_force, missing = [RLIMITS], {}
    _limit(limits, may_have_threads=readable is not None)
    if strictness == LIMITS:
        return Layers(tuple(in_force), dict.fromkeys((PRIVILEGES, FILES, CALLS), "not wanted"))
    if not sys.platform.startswith("linux"):
        missing = dict.fromkeys((PRIVILEGES, FILES, CALLS), f"{sys.platform} has none")
    else:
        given = None if readable is None else list(readable)
        reading = None if given is None else [*program_paths(), *given]
        require_apart(given or ())
        for name, problem in (
            (PRIVILEGES, _give_up_privileges(as_nobody=as_nobody)),
            (FILES, landlock.install(reading or ())),
            (CALLS, filters.install(filters.stream_rules() if reading is None else filters.picture_rules())),
        ):
            if problem:
                missing[name] = problem
            else:
                in_force.append(name)
    if missing and strictness == REQUIRED:
        reasons = ", ".join(f"{name} ({reason})" for name, reason in missing.items())
        raise SandboxError(f"this system has no {reasons}")
    return Layers(tuple(in_force), missing)


def program_paths() -> list[Path]:
    """Return the paths of Python, its libraries and what they read while loading; no file of any user."""
    system = ("/usr", "/lib", "/lib64", "/etc/ld.so.cache", "/etc/localtime", "/etc/ssl/openssl.cnf")
    devices = ("/dev/null", "/dev/urandom", "/sys/devices/system/cpu", "/proc/cpuinfo", "/proc/meminfo")
    own = ("/proc/self/maps", "/proc/self/status", "/proc/self/cgroup", "/sys/fs/cgroup")
    # Not `sys.path`: it has the working directory, and whatever PYTHONPATH names.
    python = [sysconfig.get_path(name) for name in ("stdlib", "platstdlib", "purelib", "platlib")]
    # Libraries that those of Python need may be next to them.
    libraries = os.path.join(sys.base_prefix, "lib")
    return [Path(path) for path in (*system, *devices, *own, *python, libraries)] + _package_parents()


def _package_parents() -> list[Path]:
    """Return the folders that our own packages and the libraries are imported from."""
    parents = []
    for name in (*PACKAGES, *LIBRARIES):
        try:
            spec = importlib.util.find_spec(name)
        except ModuleNotFoundError:
            continue
        # A folder that only has the name of a package has no origin.
        if spec is not None and spec.origin is not None:
            path = Path(spec.origin).absolute()
            package = path if spec.submodule_search_locations is None else path.parent
            parents.append(package.parents[name.count(".")])
    return list(dict.fromkeys(parents))


def require_apart(readable: Iterable[Path]) -> None:
    """Raise `SandboxError` for a path in the program's folders, whose other files could be read with it."""
    programs = [path.resolve() for path in program_paths()]
    for path in readable:
        given = path.resolve()
        around = next((each for each in programs if given.is_relative_to(each)), None)
        if around is not None:
            raise SandboxError(
                f"{path} is inside {around}, all of which a process that reads it could read; move it "
                "elsewhere"
            )


def _limit(limits: Limits, *, may_have_threads: bool) -> None:
    def lower(kind: int, value: int) -> None:
        _, hard = resource.getrlimit(kind)
        value = value if hard == resource.RLIM_INFINITY else min(value, hard)
        resource.setrlimit(kind, (value, value))

    lower(resource.RLIMIT_CORE, 0)
    # Writing to a pipe does not count as writing a file.
    lower(resource.RLIMIT_FSIZE, 0)
    lower(resource.RLIMIT_NOFILE, limits.open_files)
    lower(resource.RLIMIT_CPU, limits.cpu_s)
    if not may_have_threads:
        lower(resource.RLIMIT_NPROC, 0)
    lower(resource.RLIMIT_AS, limits.memory_bytes)


def _give_up_privileges(*, as_nobody: bool) -> str:
    """Give up what root may do, and that later programs get more rights; return why that fails, or ""."""
    library = ctypes.CDLL(None, use_errno=True)
    if library.prctl(filters.PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) != 0:
        return os.strerror(ctypes.get_errno())
    if as_nobody and os.geteuid() == 0:
        try:
            os.setgroups([])
            os.setresgid(NOBODY, NOBODY, NOBODY)
            os.setresuid(NOBODY, NOBODY, NOBODY)
        except OSError as error:
            return f"another user: {error.strerror}"
    header = (ctypes.c_uint32 * 2)(_CAPABILITY_VERSION, 0)
    held = (ctypes.c_uint32 * 6)()
    if library.capget(header, held) != 0:
        return os.strerror(ctypes.get_errno())
    kept = (ctypes.c_uint32 * 6)(held[0] & _READ_EVERYTHING, held[1] & _READ_EVERYTHING, 0, 0, 0, 0)
    return "" if library.capset(header, kept) == 0 else os.strerror(ctypes.get_errno())
