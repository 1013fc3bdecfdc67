"""Untrusted files are read in a process of its own, which may open nothing, send nothing and start nothing.

This side starts it (`decoding_child`), trusts nothing that it sends, and reports how it ended.
"""

import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeGuard

import structlog
from lambent_sandbox.sandbox import AVAILABLE, CALLS, EXIT_REFUSED, FILES, LIMITS, Layers

from lambent_server.api.problems import Problem, invalid
from lambent_server.core.settings import Settings
from lambent_server.storage.archive_entries import Entry, broken
from lambent_server.storage.environment_files import MEDIA_TYPES, EnvironmentHead
from lambent_server.storage.paths import is_scene_file

log = structlog.get_logger()

MAX_MESSAGE_BYTES = 64 * 1024
MAX_PIECE_BYTES = 1024 * 1024
UNKNOWN_MESSAGE = "it sent a message that no decoder sends"
# Code that runs in the process may wait instead of working, which costs no processor time.
WALL_FACTOR = 3.0
FIRST_S = 60.0
"""Time on the clock that even the smallest file has."""
EXIT_S = 5.0
"""Time between the end of its messages and that of the process."""
# How the system ends a process that uses too much of it.
_OUT_OF_RESOURCES = (-signal.SIGXCPU, -signal.SIGKILL)
_REFUSALS = {"archive": "archive_unsafe", "environment": "environment_invalid", "probe": "decoder_stopped"}
_CODES = frozenset({"archive_broken", *_REFUSALS.values()})


class Decoder:
    """One process that reads one file, and the messages that it sends."""

    def __init__(self, task: str, path: Path, settings: Settings, wall_s: float, **order: Any) -> None:
        self._refusal = _REFUSALS[task]
        self.timed_out = False
        limits = {"memory_bytes": settings.decode_memory_bytes, "cpu_s": max(1, int(settings.decode_cpu_s))}
        order |= {"task": task, "limits": limits, "sandbox": settings.sandbox}
        try:
            with path.open("rb") as file:
                self._process = subprocess.Popen(
                    [*settings.decode_command, json.dumps(order)],
                    stdin=file,
                    stdout=subprocess.PIPE,
                    stderr=subprocess.DEVNULL,
                    env=dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1") | _python_path(),
                )
        except OSError as error:
            log.error("decoder_not_started", error=str(error))
            raise _unavailable("no process could be started") from error
        self._timer = threading.Timer(wall_s, self._run_out)
        self._timer.daemon = True
        self._timer.start()

    def _run_out(self) -> None:
        self.timed_out = True
        self._process.kill()

    def close(self) -> None:
        """End the process."""
        self._timer.cancel()
        self._process.kill()
        assert self._process.stdout is not None
        self._process.stdout.close()
        self._process.wait()

    def message(self) -> dict[str, Any]:
        """Return the next message; raises the problem that it reports, or that ended the process."""
        length = int.from_bytes(self.exactly(4), "big")
        if length > MAX_MESSAGE_BYTES:
            raise self.stopped(UNKNOWN_MESSAGE)
        try:
            message = json.loads(self.exactly(length))
        except (ValueError, RecursionError) as error:
            raise self.stopped(UNKNOWN_MESSAGE) from error
        if not isinstance(message, dict):
            raise self.stopped(UNKNOWN_MESSAGE)
        if "problem" in message:
            raise self._told(message)
        return message

    def exactly(self, size: int) -> bytes:
        """Return the next bytes; raises how the process ended if there are fewer."""
        assert self._process.stdout is not None
        data = self._process.stdout.read(size)
        if len(data) < size:
            raise self._how_it_ended()
        return data

    def _told(self, message: dict[str, Any]) -> Problem:
        code, subject, text = message["problem"], message.get("subject", ""), message.get("message", "")
        if code not in _CODES or not isinstance(subject, str) or not isinstance(text, str):
            return self.stopped(UNKNOWN_MESSAGE)
        return invalid(code, f"#/{subject[:80]}" if subject else "#", text[:500])

    def ended(self) -> int:
        """Wait for the end of the process and return its exit code."""
        try:
            return self._process.wait(EXIT_S)
        except subprocess.TimeoutExpired as error:
            raise self.stopped("it stopped answering") from error

    def _how_it_ended(self) -> Problem:
        """Return the problem of a process that ended before it was done."""
        try:
            code = self.ended()
        except Problem as problem:
            return problem
        if code == EXIT_REFUSED:
            return _unavailable("this system lacks what LAMBENT_SANDBOX=required asks for")
        if code == -signal.SIGSYS:
            return self.stopped("it tried to use the network, another program or another file")
        if self.timed_out or code in _OUT_OF_RESOURCES:
            return invalid(self._refusal, "#", "reading it takes too much time or memory")
        return self.stopped(f"it ended with {_name(code)}")

    def stopped(self, reason: str) -> Problem:
        """Return the problem of a process that did something other than reading."""
        log.warning("decoder_stopped", reason=reason)
        return invalid("decoder_stopped", "#", f"the process that read this file was stopped: {reason}")


def _name(code: int) -> str:
    try:
        return signal.Signals(-code).name if code < 0 else f"code {code}"
    except ValueError:
        return f"signal {-code}"


def _python_path() -> dict[str, str]:
    """Return where the process finds this program: just as this one did."""
    return {"PYTHONPATH": ":".join(path for path in sys.path if path)}


def _unavailable(reason: str) -> Problem:
    return Problem(503, "decoder_unavailable", f"files cannot be read now: {reason}", retryable=True)


@contextmanager
def _decoder(task: str, path: Path, settings: Settings, **order: Any) -> Iterator[Decoder]:
    # Others wait for its place, so a small file must not keep it for as long as a large one may.
    by_size_s = FIRST_S + path.stat().st_size / settings.decode_bytes_per_s
    decoder = Decoder(task, path, settings, min(by_size_s, WALL_FACTOR * settings.decode_cpu_s), **order)
    try:
        yield decoder
    finally:
        decoder.close()


@contextmanager
def archive_entries(archive: Path, budget: int, settings: Settings) -> Iterator[Iterator[Entry]]:
    """Yield the entries of an archive, as `archive_entries.entries_of` does, from a process of its own.

    Files that have no place in a scene come without contents.
    """
    limits = {"budget": budget, "max_files": settings.max_scene_files}
    with _decoder("archive", archive, settings, **limits) as decoder:
        yield _entries(decoder)


def _entries(decoder: Decoder) -> Iterator[Entry]:
    while True:
        told = decoder.message()
        if told.get("done") is True:
            return
        name, size = told.get("name"), told.get("size")
        if not isinstance(name, str) or not isinstance(size, int) or size < 0:
            raise broken("an entry has no name or no size")
        source = _Member(decoder) if is_scene_file(name.removeprefix("./")) else None
        yield name, size, source


class _Member:
    """The contents of an entry, as they come."""

    def __init__(self, decoder: Decoder) -> None:
        self._decoder = decoder

    def read(self, _size: int = -1) -> bytes:
        """Return the next piece; empty at the end."""
        size = int.from_bytes(self._decoder.exactly(4), "big")
        if size == 0xFFFFFFFF:
            # Something was wrong in the middle: a message says what.
            self._decoder.message()
        if size > MAX_PIECE_BYTES:
            raise broken("an entry has no contents")
        return self._decoder.exactly(size)


def environment_head(path: Path, settings: Settings) -> EnvironmentHead:
    """Return format and size of an environment; raises `environment_invalid` or `decoder_stopped`."""
    with _decoder("environment", path, settings, max_pixels=settings.max_environment_pixels) as decoder:
        told = decoder.message()
        kind, width, height = told.get("format"), told.get("width"), told.get("height")
        is_known = isinstance(kind, str) and kind in MEDIA_TYPES
        if not is_known or not _is_size(width) or not _is_size(height):
            raise decoder.stopped(UNKNOWN_MESSAGE)
        if width * height > settings.max_environment_pixels:
            raise decoder.stopped(UNKNOWN_MESSAGE)
    return EnvironmentHead(str(kind), width, height)


def _is_size(value: object) -> TypeGuard[int]:
    # True is an int as well.
    return isinstance(value, int) and not isinstance(value, bool) and value >= 1


def probe(settings: Settings) -> Layers:
    """Return the layers around decoding on this system, having tried to break out of them."""
    available = settings.model_copy(
        update={"sandbox": settings.sandbox if settings.sandbox == LIMITS else AVAILABLE}
    )
    with _decoder("probe", Path(os.devnull), available) as decoder:
        told = decoder.message()
        code = decoder.ended()
    in_force, missing = tuple(map(str, told["in_force"])), dict(told["missing"])
    if CALLS in in_force and code != -signal.SIGSYS:
        in_force = tuple(name for name in in_force if name != CALLS)
        missing[CALLS] = f"a process that opened a socket ended with {_name(code)}"
    if FILES in in_force and told["opened"]:
        in_force = tuple(name for name in in_force if name != FILES)
        missing[FILES] = "a file could be opened"
    return Layers(in_force, missing)
