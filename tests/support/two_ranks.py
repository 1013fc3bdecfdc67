"""Ranks for tests: this process and another one, which do the same at once."""

import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import torch
from flashcache.parallel.processes import Processes
from flashcache.parallel.ranks import Ranks
from flashcache.parallel.shared_memory import SharedMemory


class TwoRanks:
    """Two processes that are ranks; `both` calls a function in each."""

    def __init__(self, processes: Processes) -> None:
        self._processes = processes
        self._folder = tempfile.TemporaryDirectory()
        self.both(join, Path(self._folder.name) / "meeting")

    def both(self, function: Callable[..., Any], *arguments: Any) -> list[Any]:
        """Return what `function` of a module returns on each rank, given the rank and the arguments."""
        asked = partial(_call, function, arguments)
        self._processes.give([asked], SharedMemory(1))
        return self._processes.ask([(0,), (1,)], asked)

    def close(self) -> None:
        self.both(leave)
        self._folder.cleanup()


_JOINED: dict[str, Ranks] = {}


def _call(function: Callable[..., Any], arguments: tuple[Any, ...], number: int) -> Any:
    if function is join:
        return join(number, *arguments)
    return function(_JOINED["ranks"], *arguments)


def join(number: int, meeting: Path) -> None:
    _JOINED["ranks"] = Ranks.join(number, 2, meeting, torch.device("cpu"), step_timeout_s=60.0)


def leave(ranks: Ranks) -> None:
    ranks.close()
    del _JOINED["ranks"]


@contextmanager
def two_ranks() -> Iterator[TwoRanks]:
    """Yield this process and another one as ranks; functions may be those of modules in `support`."""
    before = os.environ.get("PYTHONPATH")
    os.environ["PYTHONPATH"] = os.pathsep.join(path for path in sys.path if path)
    try:
        processes = Processes(2)
    finally:
        os.environ.pop("PYTHONPATH")
        if before is not None:
            os.environ["PYTHONPATH"] = before
    with processes:
        made = TwoRanks(processes)
        try:
            yield made
        finally:
            made.close()
