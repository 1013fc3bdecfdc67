"""One of several ranks that train together: what `lambent_run.run.rank_processes` starts."""

import os
import pickle
import signal
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from lambent_compute.group_signals import GROUP_SIGNALS, ignore
from lambent_core.errors import Stopped
from lambent_core.startup import end_with_parent, prepare
from lambent_proto.v1.job_pb2 import Progress

from lambent_run.run.rank_processes import END, ENDED, SAFE, STOP, RankOrder


def serve(descriptor: int) -> None:
    """Do what the process that started this one says over a socket, and end when it does."""
    end_with_parent(signal.SIGKILL)
    # Whatever signals the whole group gets: the run decides when ranks end, and after which checkpoint.
    ignore(*GROUP_SIGNALS)
    prepare()
    starter = _Starter(Connection(descriptor))
    order = starter.receive()
    error: Exception | None = None
    try:
        _train(order, starter)
    except Exception as found:
        error = found
        if not isinstance(found, Stopped):
            traceback.print_exc()
    starter.send(ENDED, None if error is None else _sendable(error))
    # Until all have finished: a rank that leaves earlier breaks the connections of the others.
    while starter.receive() != END:
        pass
    os._exit(0)


def _train(order: RankOrder, starter: "_Starter") -> None:
    import torch
    from flashcache.parallel.ranks import Ranks

    from lambent_run.run.context import TaskContext

    ranks = Ranks.join(
        order.number,
        order.count,
        order.meeting,
        torch.device(order.device),
        step_timeout_s=order.step_timeout_s,
    )
    context = TaskContext(
        spec=order.spec,
        run_dir=order.run_dir,
        device=order.device,
        reporter=RankReporter(starter, speaks=order.number == 0),
        task=order.task,
        clock=order.clock,
        ranks=ranks,
    )
    getattr(import_module("lambent_run.run.tasks.stages"), order.task)(context)


class _Starter:
    """The process that started this one; this one ends as soon as it is gone."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    def send(self, *message: Any) -> None:
        with _ending():
            self._connection.send(message)

    def receive(self) -> Any:
        with _ending():
            return self._connection.recv()

    def has_said_something(self) -> bool:
        with _ending():
            return self._connection.poll()


@contextmanager
def _ending() -> Iterator[None]:
    """End this process where the one that started it is gone."""
    try:
        yield
    except (EOFError, OSError):
        os._exit(1)


class RankReporter:
    """The `Reporter` of a rank: the first one tells the run, which passes it on; the others are silent."""

    def __init__(self, starter: _Starter, *, speaks: bool) -> None:
        self._starter, self._speaks = starter, speaks
        self._stop = False

    def progress(self, progress: Progress) -> None:
        """Tell how far the task is."""
        self._tell("progress", progress)

    def preview(self, name: str, png: bytes) -> None:
        """Show a small picture."""
        self._tell("preview", name, png)

    def checkpoint(self, stage: str, step: int, folder: Path) -> None:
        """Make a checkpoint durable, and wait until it is."""
        self._tell("checkpoint", stage, step, folder)
        while self._speaks and self._listen() != SAFE:
            pass

    def artifact(self, name: str, path: Path) -> None:
        """Publish a file of the result."""
        self._tell("artifact", name, path)

    def finding(self, code: str, message: str, *, subject: str = "", error: bool = False) -> None:
        """Tell the owner of the scene something about it."""
        self._tell("finding", code, message, subject=subject, error=error)

    def log(self, event: str, **fields: object) -> None:
        """Write a line for operators."""
        self._tell("log", event, **fields)

    def should_stop(self) -> bool:
        """Return whether the run was asked to end."""
        while self._starter.has_said_something():
            self._listen()
        return self._stop

    def _listen(self) -> Any:
        message = self._starter.receive()
        self._stop = self._stop or message == STOP
        return message

    def _tell(self, method: str, *arguments: object, **named: object) -> None:
        if self._speaks:
            self._starter.send(method, arguments, named)


def _sendable(error: Exception) -> Exception:
    """Return an exception that another process can read, in words where it cannot be sent as it is."""
    try:
        pickle.loads(pickle.dumps(error))  # noqa: S301  # Its own words.
    except Exception:
        return RuntimeError(f"{type(error).__name__}: {error}")
    return error
