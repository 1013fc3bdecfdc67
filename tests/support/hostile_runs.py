"""Runs what reads untrusted files on one file after another, each time in a copy of this process.

A copy is made by `fork`, which takes milliseconds where starting Python takes a second. It enters the sandbox
as the real processes do, with limits above what this process has already, and says what it found through a
pipe. Do not use it in a process with threads.
"""

import contextlib
import io
import json
import os
import resource
import signal
import sys
import traceback
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

from lambent_sandbox.sandbox import Limits, enter

MIB = 2**20
CPU_S = 20
OPEN = object()


@dataclass(frozen=True, kw_only=True, slots=True)
class Run:
    """How a copy of this process ended."""

    output: bytes
    code: int
    """Exit code; negative for a signal."""
    grown_kib: int
    """Memory beyond what this process has."""
    cpu_s: float
    trace: str = ""
    """What an exception that nobody expected said."""


def vm_bytes() -> int:
    """Return the address space that this process has."""
    return int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()


def run(
    act: Callable[[IO[bytes]], None],
    memory_bytes: int,
    readable: list[Path] | None,
    *,
    sandboxed: bool = True,
) -> Run:
    """Return how a copy of this process ended that entered the sandbox and did `act`; `act` gets its output.

    Without `sandboxed` it has limits of memory and time only: the client's library reads its user's files.
    """
    limits = Limits(memory_bytes=vm_bytes() + memory_bytes, cpu_s=CPU_S, open_files=1024)
    reader, writer = os.pipe()
    traces, told = os.pipe()
    sys.stdout.flush()
    pid = os.fork()
    if pid == 0:
        os.close(reader)
        os.close(traces)
        _be_child(act, limits, readable if sandboxed else OPEN, writer, told)
    os.close(writer)
    os.close(told)
    # Traces are short: they never fill their pipe before the output ends.
    with os.fdopen(reader, "rb") as stream, os.fdopen(traces, "rb") as lines:
        output, said = stream.read(), lines.read()
    before, trace = int.from_bytes(said[:8], "big"), said[8:].decode(errors="replace")
    _, status, usage = os.wait4(pid, 0)
    return Run(
        output=output,
        code=os.waitstatus_to_exitcode(status),
        grown_kib=max(0, usage.ru_maxrss - before),
        cpu_s=usage.ru_utime + usage.ru_stime,
        trace=trace,
    )


def _be_child(
    act: Callable[[IO[bytes]], None],
    limits: Limits,
    readable: list[Path] | object | None,
    writer: int,
    told: int,
) -> None:
    code = 1
    try:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        os.write(told, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss.to_bytes(8, "big"))
        if readable is OPEN:
            resource.setrlimit(resource.RLIMIT_AS, (limits.memory_bytes, limits.memory_bytes))
            resource.setrlimit(resource.RLIMIT_CPU, (limits.cpu_s, limits.cpu_s))
        else:
            enter(limits, "available", readable=readable)
        with os.fdopen(writer, "wb", buffering=0, closefd=False) as out:
            act(out)
        code = 0
    except MemoryError:
        # The parent of the real process says so for it.
        code = OUT_OF_MEMORY
        os.write(told, traceback.format_exc()[-3000:].encode())
    except BaseException:
        with contextlib.suppress(Exception):
            os.write(told, traceback.format_exc()[-3000:].encode())
    finally:
        os._exit(code)


OUT_OF_MEMORY = 77


@dataclass(kw_only=True, slots=True)
class Verdict:
    """What became of one hostile file."""

    name: str
    refused: bool
    codes: list[str] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)
    """What must not happen: tracebacks, foreign calls, refusals that name nothing, too much memory."""
    grown_kib: int = 0
    cpu_s: float = 0.0
    texts: list[tuple[str, str]] = field(default_factory=list)
    """Code and subject or message of each finding."""

    def names(self, file: str, codes: set[str]) -> bool:
        """Return whether a finding with one of `codes` names a file."""
        return any(code in codes and file in text for code, text in self.texts)


def judge(name: str, done: Run) -> Verdict:
    """Return a verdict that knows how the process ended, and nothing of what it said."""
    found = Verdict(name=name, refused=True, grown_kib=done.grown_kib, cpu_s=done.cpu_s)
    if done.code == -signal.SIGSYS:
        found.faults.append("it made a call that reading does not need")
    elif done.code in (-signal.SIGXCPU, -signal.SIGKILL, OUT_OF_MEMORY):
        found.codes.append("stopped")
    elif done.code:
        found.faults.append(f"ended with {done.code}: {done.trace}")
    return found


def captured(act: Callable[[], None]) -> Callable[[IO[bytes]], None]:
    """Return `act` with what it prints sent as its output."""

    def do(out: IO[bytes]) -> None:
        text = io.TextIOWrapper(out, encoding="utf-8", errors="replace", write_through=True)
        with contextlib.redirect_stdout(text):
            act()
        text.detach()

    return do


def lines_of(output: bytes, kind: str) -> list[Any]:
    """Return the values of the lines of one kind."""
    prefix = kind.encode() + b" "
    return [json.loads(line[len(prefix) :]) for line in output.splitlines() if line.startswith(prefix)]
