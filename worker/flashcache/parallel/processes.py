"""Processes beside this one, each with one core, that hold an object and answer questions with it."""

import os
import pickle
import socket
import subprocess
import sys
import traceback
from collections.abc import Callable, Sequence
from contextlib import suppress
from multiprocessing.connection import Connection
from types import TracebackType
from typing import Any

import torch
from lambent_compute.group_signals import GROUP_SIGNALS, held_back, ignore

from flashcache.errors import ProcessEndedError
from flashcache.parallel.shared_memory import Channel, SharedMemory

Answerer = Callable[..., Any]
"""What a process holds: it is called with the members of a question and returns the answer."""

_MODULE = "flashcache.parallel.processes"
_GRACE_S = 10.0


class Processes:
    """`count` processes, of which the first is this one; the others end when this one does.

    They are started at once and load their libraries while the caller continues. They ignore the signals that
    a terminal or a supervisor sends to all processes of a run: this one decides what happens.
    """

    def __init__(self, count: int) -> None:
        self._others = [_Other() for _ in range(count - 1)]

    @property
    def count(self) -> int:
        """Number of processes, this one included."""
        return 1 + len(self._others)

    def give(self, answerers: Sequence[Answerer], block: SharedMemory) -> None:
        """Give the second and further processes an object each, instead of an earlier one.

        Tensors in `block` stay where they are, for all processes; its file is closed.
        """
        for other, answerer in zip(self._others[: len(answerers)], answerers, strict=True):
            other.give(answerer, block)
        block.close_file()

    def ask(self, questions: Sequence[tuple[Any, ...]], own: Answerer) -> list[Any]:
        """Return the answers in order; the first question is answered by `own`, in this process.

        Raises what the first failing answerer raised, once all have ended, and `ProcessEndedError` for a
        process that is gone.
        """
        asked: list[_Other] = []
        answers: list[tuple[bool, Any]] = []
        try:
            for other, question in zip(self._others[: len(questions) - 1], questions[1:], strict=True):
                other.ask(question)
                asked.append(other)
            answers.append((True, own(*questions[0])))
        finally:
            # Also after an error: an answer that is left unread would be taken for that of the next question.
            answers += [other.answer() for other in asked]
        for succeeded, answer in answers:
            if not succeeded:
                raise answer
        return [answer for _, answer in answers]

    def close(self) -> None:
        """End the other processes."""
        for other in self._others:
            other.close()
        self._others = []

    def __enter__(self) -> "Processes":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class _Other:
    """Another process, seen from the one that started it."""

    def __init__(self) -> None:
        ours, theirs = socket.socketpair()
        with theirs:
            command = [sys.executable, "-P", "-c", f"from {_MODULE} import serve; serve({theirs.fileno()})"]
            with held_back(*GROUP_SIGNALS):
                self._process = subprocess.Popen(
                    command, pass_fds=(theirs.fileno(),), stdin=subprocess.DEVNULL
                )
        self._channel = Channel(Connection(ours.detach()))

    def give(self, answerer: Answerer, block: SharedMemory) -> None:
        try:
            self._channel.send("block")
            self._channel.share(block, self._process.pid)
            self._channel.send(answerer)
        except OSError as error:
            raise self._ended() from error

    def ask(self, question: tuple[Any, ...]) -> None:
        try:
            self._channel.send(question)
        except OSError as error:
            raise self._ended() from error

    def answer(self) -> tuple[bool, Any]:
        """Return whether the process could answer, and the answer or the exception."""
        try:
            reply: tuple[bool, Any] = self._channel.receive()
        except (EOFError, OSError):
            return False, self._ended()
        return reply

    def close(self) -> None:
        self._channel.close()
        try:
            self._process.wait(_GRACE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _ended(self) -> ProcessEndedError:
        try:
            code = self._process.wait(_GRACE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            code = self._process.wait()
        return ProcessEndedError(code)


def serve(descriptor: int) -> None:
    """Answer questions until the process that started this one closes the socket or ends."""
    ignore(*GROUP_SIGNALS)
    torch.set_num_threads(1)
    channel = Channel(Connection(descriptor))
    answerer: Answerer | None = None
    with suppress(EOFError, OSError):
        while True:
            message = channel.receive()
            if message == "block":
                answerer = None  # Before the next one arrives: both may be large.
                channel.receive_block()
                answerer = channel.receive()
                continue
            assert answerer is not None
            try:
                answer = True, answerer(*message)
            except Exception as error:
                answer = False, _sendable(error)
            channel.send(answer)
    # Without the interpreter's farewell: there is nothing to write.
    os._exit(0)


def _sendable(error: Exception) -> Exception:
    """Return an exception that can be sent to another process, with the trace of this one as a note."""
    error.add_note("In another process:\n" + "".join(traceback.format_exception(error)))
    try:
        pickle.loads(pickle.dumps(error))  # noqa: S301  # Its own words.
    except Exception:
        return RuntimeError(f"{type(error).__name__}: {error}")
    return error
