"""Filters of system calls (seccomp), as programs for the kernel's classic BPF machine.

Three answers: allowed; refused with EPERM, as every call that a filter does not name; and the end of the
process by SIGSYS, for calls that no decoder makes unless foreign code runs in it.
"""

import ctypes
import os
import platform
import struct
from dataclasses import dataclass

from lambent_sandbox import calls

PR_SET_NO_NEW_PRIVS = 38
_PR_SET_SECCOMP = 22
_MODE_FILTER = 2
_SET_MODE_FILTER = 1
_FLAG_TSYNC = 1

_ALLOW = 0x7FFF0000
_KILL = 0x80000000
_ERRNO = 0x00050000

# Instructions: load a 32-bit word of the call's description, mask it, compare it, return.
_LOAD, _AND, _EQUAL, _AT_LEAST, _RETURN = 0x20, 0x54, 0x15, 0x35, 0x06
# Offsets in struct seccomp_data.
_NUMBER, _ARCHITECTURE, _ARGUMENTS = 0, 4, 16
_X32_BIT = 0x40000000
_WHOLE = 0xFFFFFFFF


@dataclass(frozen=True, slots=True)
class Word:
    """A condition: this half of an argument has this value. The lower half is all of a number of 32 bits."""

    argument: int
    value: int
    upper: bool = False


@dataclass(frozen=True, slots=True)
class Rule:
    """What happens with a call.

    With `mask` it depends on the bits of argument `argument` under the mask: a rule that allows applies where
    they are `value`, one that kills where they are not. `also` has more conditions of a rule that allows.
    """

    name: str
    action: int = _ALLOW
    argument: int = 0
    mask: int = 0
    value: int = 0
    also: tuple["Word", ...] = ()


def _all(action: int, *names: str) -> tuple[Rule, ...]:
    return tuple(Rule(name, action) for name in names)


# Memory, threads that exist, time, and files that are open already.
_QUIET = (
    *_all(_ALLOW, "read", "readv", "pread64", "preadv", "write", "writev", "lseek", "close", "fstat", "dup"),
    *_all(_ALLOW, "poll", "ppoll", "fadvise64", "brk", "munmap", "mremap", "madvise"),
    *_all(_ALLOW, "futex", "rt_sigaction", "rt_sigprocmask", "rt_sigreturn", "sigaltstack", "sched_yield"),
    *_all(_ALLOW, "restart_syscall", "exit", "exit_group", "clock_gettime", "clock_getres", "gettimeofday"),
    *_all(
        _ALLOW, "clock_nanosleep", "nanosleep", "time", "times", "getrandom", "getpid", "gettid", "getppid"
    ),
    *_all(_ALLOW, "getuid", "geteuid", "getgid", "getegid", "getrusage", "getrlimit", "uname", "sysinfo"),
    *_all(_ALLOW, "sched_getaffinity", "getcpu", "membarrier", "get_mempolicy", "set_robust_list", "rseq"),
    # Others can have the kernel send signals to any process of this user.
    *(
        Rule("fcntl", _ALLOW, 1, _WHOLE, command)
        for command in (calls.F_DUPFD, calls.F_DUPFD_CLOEXEC, calls.F_GETFD, calls.F_SETFD, calls.F_GETFL)
    ),
)
# What only foreign code would try. Where there is no such call, its neighbours are enough.
_HOSTILE = (
    *_all(_KILL, "socket", "socketpair", "connect", "accept", "accept4", "bind", "listen", "sendto"),
    *_all(_KILL, "sendmsg", "sendmmsg", "execve", "execveat", "fork", "vfork", "ptrace", "bpf", "unshare"),
    *_all(_KILL, "setns", "mount", "chroot", "process_vm_readv", "process_vm_writev", "kill", "creat"),
    *_all(_KILL, "truncate", "rename", "renameat", "renameat2", "mkdir", "mkdirat", "rmdir", "unlink"),
    *_all(_KILL, "unlinkat", "link", "linkat", "symlink", "symlinkat", "mknod", "mknodat", "chmod"),
    *_all(_KILL, "fchmodat", "fchmodat2", "chown", "lchown", "fchownat", "setxattr", "setuid", "setgid"),
    *_all(_KILL, "io_uring_setup"),
    # These take their arguments from memory, which a filter cannot look at. Programs use the older ones then.
    *_all(_ERRNO | calls.ENOSYS, "clone3", "openat2"),
    Rule("open", _KILL, 1, calls.CREATING, 0),
    Rule("openat", _KILL, 2, calls.CREATING, 0),
)
_NAMES_THREADS = (
    Rule("prctl", _ALLOW, 0, _WHOLE, calls.PR_SET_NAME),
    Rule("prctl", _ALLOW, 0, _WHOLE, calls.PR_GET_NAME),
)


def stream_rules() -> tuple[Rule, ...]:
    """Return the rules for a process that reads an open file and writes to a pipe, and opens nothing.

    It looks at no path either: `newfstatat` is refused, which some libraries use for open files too, and
    which the readers of files that are open already do not need.
    """
    return (
        *_HOSTILE,
        *_QUIET,
        *_NAMES_THREADS,
        Rule("mmap", _ALLOW, 2, calls.PROT_EXEC, 0),
        Rule("mprotect", _ALLOW, 2, calls.PROT_EXEC, 0),
        Rule("clone", _KILL),
        # A signal for oneself, which `abort` sends.
        Rule("tgkill", _ALLOW, 0, _WHOLE, os.getpid()),
    )


def picture_rules() -> tuple[Rule, ...]:
    """Return the rules for a process that opens files for reading only, loads libraries and has threads.

    The calls that look at a path without opening it are allowed for every path: loading a library makes them,
    a filter cannot follow the address of a path, and Landlock has no right for them (SECURITY.md).
    """
    return (
        *_HOSTILE,
        *_QUIET,
        *_NAMES_THREADS,
        Rule("open", _ALLOW, 1, calls.WRITING, 0),
        Rule("openat", _ALLOW, 2, calls.WRITING, 0),
        *_all(
            _ALLOW, "newfstatat", "stat", "lstat", "statx", "access", "faccessat", "faccessat2", "readlink"
        ),
        *_all(_ALLOW, "readlinkat", "getdents64", "getcwd", "statfs", "fstatfs"),
        # Code comes from files, never from memory that was written.
        Rule("mmap", _ALLOW, 2, calls.PROT_EXEC, 0),
        Rule("mmap", _ALLOW, 3, calls.MAP_ANONYMOUS, 0),
        Rule("mprotect", _ALLOW, 2, calls.PROT_EXEC, 0),
        Rule("clone", _ALLOW, 0, calls.CLONE_THREAD, calls.CLONE_THREAD),
        Rule("clone", _KILL),
        # Limits may be read, those of this process: the address of new ones is zero in both halves.
        Rule("prlimit64", _ALLOW, 0, _WHOLE, 0, (Word(2, 0), Word(2, 0, upper=True))),
        Rule("tgkill", _ALLOW, 0, _WHOLE, os.getpid()),
    )


def machine() -> str | None:
    """Return the name of this machine's table of calls; None where there is none."""
    name = platform.machine()
    known = {"x86_64": calls.X86_64, "AMD64": calls.X86_64, "aarch64": calls.AARCH64, "arm64": calls.AARCH64}
    return known.get(name) if struct.calcsize("P") == 8 else None


def program(rules: tuple[Rule, ...], table: str) -> bytes:
    """Return the instructions for a machine; the first rule that applies to a call decides."""
    numbers = calls.NUMBERS[table]
    out = [
        _instruction(_LOAD, _ARCHITECTURE),
        _instruction(_EQUAL, calls.AUDIT_ARCH[table], 1, 0),
        _instruction(_RETURN, _KILL),
        _instruction(_LOAD, _NUMBER),
    ]
    if table == calls.X86_64:
        # The same calls once more, under other numbers.
        out += [_instruction(_AT_LEAST, _X32_BIT, 0, 1), _instruction(_RETURN, _KILL)]
    for rule in rules:
        if rule.name in numbers:
            out += _block(rule, numbers[rule.name])
    out.append(_instruction(_RETURN, _ERRNO | calls.EPERM))
    return b"".join(out)


def _block(rule: Rule, number: int) -> list[bytes]:
    """Return the instructions of a rule, with the call's number loaded before and after them."""
    if not rule.mask:
        return [_instruction(_EQUAL, number, 0, 1), _instruction(_RETURN, rule.action)]
    # A rule that kills does so where the bits differ from its value, one that allows where they are equal.
    more = 2 * len(rule.also)
    hit, miss = (1, 0) if rule.action == _KILL else (0, 1 + more)
    out = [
        _instruction(_EQUAL, number, 0, 5 + more),
        _instruction(_LOAD, _ARGUMENTS + 8 * rule.argument),
        _instruction(_AND, rule.mask),
        _instruction(_EQUAL, rule.value, hit, miss),
    ]
    for word in rule.also:
        more -= 2
        # Both machines have the lower half first.
        out.append(_instruction(_LOAD, _ARGUMENTS + 8 * word.argument + 4 * word.upper))
        out.append(_instruction(_EQUAL, word.value, 0, 1 + more))
    return [*out, _instruction(_RETURN, rule.action), _instruction(_LOAD, _NUMBER)]


def _instruction(code: int, value: int, if_true: int = 0, if_false: int = 0) -> bytes:
    return struct.pack("=HBBI", code, if_true, if_false, value)


class _Program(ctypes.Structure):
    _fields_ = (("length", ctypes.c_ushort), ("instructions", ctypes.c_void_p))


def install(rules: tuple[Rule, ...]) -> str:
    """Restrict this process and all its threads for good; return why that is impossible, or ""."""
    table = machine()
    if table is None:
        return f"no table of system calls for {platform.machine()}"
    code = program(rules, table)
    buffer = ctypes.create_string_buffer(code, len(code))
    given = _Program(len(code) // 8, ctypes.addressof(buffer))
    library = ctypes.CDLL(None, use_errno=True)
    number = calls.NUMBERS[table]["seccomp"]
    if library.syscall(number, _SET_MODE_FILTER, _FLAG_TSYNC, ctypes.byref(given)) == 0:
        return ""
    if library.prctl(_PR_SET_SECCOMP, _MODE_FILTER, ctypes.byref(given), 0, 0) == 0:
        return ""
    return os.strerror(ctypes.get_errno())
