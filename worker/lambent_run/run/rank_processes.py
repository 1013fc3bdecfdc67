"""The training of a run by several ranks on this machine, seen from the run that starts them.

Every rank is a process of its own (`lambent_run.run.rank`) with one device. The first tells this process
what it would tell a server or a terminal, and only this process talks to those. Ranks end with this process.
One that is killed ends all; they start again from the last checkpoint (decision 0029).
"""

import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from pathlib import Path
from types import TracebackType
from typing import Any

from flashcache.errors import ProcessEndedError, RankLostError
from lambent_compute.group_signals import GROUP_SIGNALS, held_back
from lambent_core.errors import Stopped, WorkerError
from lambent_core.startup import cores_in_use, with_parent

from lambent_run.run.context import Clock, TaskContext
from lambent_run.run.spec import RunSpec

PROGRAM = "lambent_run.run.rank"
"""Module with the function `serve` that a rank calls."""
DIVIDED = ("cache", "joint")
"""Tasks whose steps ranks divide among them."""
MOST_LOSSES = 20
"""Times that the ranks of a task are started again because one was lost."""
MOST_LOSSES_IN_A_ROW = 3
"""The same without a checkpoint in between."""
STOP, SAFE, END = "stop", "safe", "end"
"""Messages to ranks: to end after a checkpoint, that a checkpoint is kept, that all have finished."""
ENDED = "ended"
"""What ranks say last, with the exception that ended them or None."""
STEP_TIMEOUT_S = 600.0
"""Time that ranks wait for one of them within a step."""
_POLL_S = 0.1
_GRACE_S = 10.0
"""Time for a rank to say what happened, when others miss it, and for its process to end."""


@dataclass(frozen=True, kw_only=True, slots=True)
class RankOrder:
    """What a rank does."""

    number: int
    count: int
    meeting: Path
    """File over which the ranks find each other."""
    task: str
    device: str
    spec: RunSpec
    run_dir: Path
    clock: Clock
    step_timeout_s: float


def train_by_ranks(context: TaskContext) -> None:
    """Run a task of `DIVIDED` by the ranks of the context, which start again where one of them is killed.

    Raises `Stopped` after a checkpoint when the reporter asks to end, what the task raises on any rank, and
    `ProcessEndedError` or `WorkerError` (`ranks.lost`) where ranks are lost again and again.
    """
    for name, rays in _batches(context):
        if rays % context.num_ranks:
            left = rays - rays % context.num_ranks
            context.reporter.log("ranks.batch_rounded", batch=name, rays=rays, divided=left)
    lost = in_a_row = 0
    while True:
        with _Ranks(context) as ranks:
            try:
                ranks.train()
                return
            except RankLostError as error:
                lost += 1
                in_a_row = 1 if ranks.num_checkpoints else in_a_row + 1
                if context.reporter.should_stop():
                    raise Stopped from error
                context.reporter.log("ranks.lost", stage=context.task, lost=lost, reason=str(error))
                if lost >= MOST_LOSSES or in_a_row >= MOST_LOSSES_IN_A_ROW:
                    raise _given_up(error, lost) from error


def _batches(context: TaskContext) -> list[tuple[str, int]]:
    if context.task == "cache":
        return [("stage_one", context.config.stage_one.num_rays)]
    two = context.config.stage_two
    return [("stage_two", two.num_rays)] + [("distil", two.distil.num_points)] * bool(two.distil.num_steps)


def _given_up(error: RankLostError, lost: int) -> Exception:
    if isinstance(error, _RankEndedError):
        return ProcessEndedError(error.exit_code, of_ranks=lost)
    return WorkerError(
        "ranks.lost", f"the training was started again {lost - 1} times; the last time, {error}"
    )


class _RankEndedError(RankLostError):
    """A rank ended without a word."""

    def __init__(self, number: int, exit_code: int) -> None:
        how = f"signal {-exit_code}" if exit_code < 0 else f"exit code {exit_code}"
        super().__init__(f"rank {number} ended with {how}")
        self.exit_code = exit_code


class _Ranks:
    """The processes of one attempt."""

    def __init__(self, context: TaskContext) -> None:
        self.num_checkpoints = 0
        self._context = context
        self._folder = tempfile.TemporaryDirectory(prefix="lambent-ranks-")
        self._told_to_stop = False
        count = context.num_ranks
        threads = str(max(1, cores_in_use() // count))
        self._ranks = [_Rank(number, threads) for number in range(count)]
        for rank in self._ranks:
            on_gpu = context.device.startswith("cuda")
            order = RankOrder(
                number=rank.number,
                count=count,
                meeting=Path(self._folder.name) / "meeting",
                task=context.task,
                device=f"cuda:{rank.number}" if on_gpu else context.device,
                spec=context.spec,
                run_dir=context.run_dir,
                clock=context.clock,
                step_timeout_s=STEP_TIMEOUT_S,
            )
            rank.tell(order)

    def __enter__(self) -> "_Ranks":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for rank in self._ranks:
            rank.kill()
        self._folder.cleanup()

    def train(self) -> None:
        """Pass on what the first rank reports until all have finished."""
        while not all(rank.finished for rank in self._ranks):
            self._listen(_POLL_S)
            if any(rank.failed for rank in self._ranks):
                self._raise()
            if self._context.reporter.should_stop() and not self._told_to_stop:
                self._told_to_stop = True
                self._ranks[0].tell(STOP)
        for rank in self._ranks:
            rank.tell(END)
        if any(isinstance(rank.error, Stopped) for rank in self._ranks):
            raise Stopped

    def _listen(self, timeout_s: float) -> None:
        open_ones = {rank.connection: rank for rank in self._ranks if not rank.finished and not rank.failed}
        for connection in wait(list(open_ones), timeout_s):
            rank = open_ones[connection]  # type: ignore[index]
            report = rank.heard()
            if report is None:
                continue
            kind, arguments, named = report
            getattr(self._context.reporter, kind)(*arguments, **named)
            if kind == "checkpoint":
                self.num_checkpoints += 1
                rank.tell(SAFE)

    def _raise(self) -> None:
        """Raise why ranks failed: an error of the work itself, or else that one was lost."""
        until = time.monotonic() + _GRACE_S
        while not self._causes() and time.monotonic() < until:
            if all(rank.finished or rank.failed for rank in self._ranks) or self._ended():
                break
            self._listen(_POLL_S)
        for error in (*self._causes(), *self._ended()):
            raise error
        raise next(rank.error for rank in self._ranks if isinstance(rank.error, RankLostError))

    def _ended(self) -> list[Exception]:
        """Return the ends of ranks that said nothing, those that were killed first."""
        ended = [(rank.number, rank.exit_code) for rank in self._ranks if rank.exit_code is not None]
        ended.sort(key=lambda end: end[1] != -signal.SIGKILL)
        return [_RankEndedError(number, code) for number, code in ended]

    def _causes(self) -> list[Exception]:
        errors = [rank.error for rank in self._ranks if rank.error is not None]
        return [error for error in errors if not isinstance(error, RankLostError | Stopped)]


@dataclass
class _Rank:
    """One rank, seen from the process that started it."""

    number: int
    threads: str
    finished: bool = False
    error: Exception | None = None
    exit_code: int | None = None
    """How it ended without a word; None: it has not."""
    connection: Connection = field(init=False)

    def __post_init__(self) -> None:
        ours, theirs = socket.socketpair()
        with theirs:
            program = f"from {PROGRAM} import serve; serve({theirs.fileno()})"
            with held_back(*GROUP_SIGNALS):
                self._process = subprocess.Popen(
                    [sys.executable, "-P", "-c", program],
                    pass_fds=(theirs.fileno(),),
                    stdin=subprocess.DEVNULL,
                    stdout=2,
                    env=with_parent() | {"OMP_NUM_THREADS": self.threads},
                )
        self.connection = Connection(ours.detach())

    @property
    def failed(self) -> bool:
        return self.exit_code is not None or (self.error is not None and not isinstance(self.error, Stopped))

    def tell(self, message: Any) -> None:
        """Send a message; that a rank is gone is noticed where it is listened to."""
        with suppress(OSError):
            self.connection.send(message)

    def heard(self) -> tuple[str, tuple[Any, ...], dict[str, Any]] | None:
        """Return a waiting report, as a method of the reporter and its arguments.

        None for the end of the rank, which is noted.
        """
        try:
            message = self.connection.recv()
        except (EOFError, OSError):
            try:
                self.exit_code = self._process.wait(_GRACE_S)
            except subprocess.TimeoutExpired:
                self.kill()
                self.exit_code = -signal.SIGKILL
            return None
        if message[0] != ENDED:
            return message  # type: ignore[no-any-return]
        self.error = message[1]
        self.finished = not self.failed
        return None

    def kill(self) -> None:
        """End the process, whatever it does."""
        self.connection.close()
        if self._process.poll() is None:
            with suppress(ProcessLookupError):
                os.kill(self._process.pid, signal.SIGKILL)
        self._process.wait()
