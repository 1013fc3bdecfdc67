"""Executors, which start run processes: the protocol, and one module for each kind."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, TypeGuard

from lambent_server.core.settings import Settings

# How an executor finds a process; stored in the job's row, so it is JSON and survives the server. It has
# `executor`, `host`, `server` and `gpus` as soon as the row says that the job runs, and `run`, its name,
# as soon as the process exists. The rest is read by the executor alone.
Handle = dict[str, Any]


def is_placed(handle: Handle | None) -> TypeGuard[Handle]:
    """Return whether a handle is that of a run that was started, and leads to its process."""
    return handle is not None and "run" in handle


class ExecutorAwayError(Exception):
    """The executor cannot say at present whether a process exists, or cannot start one."""


def run_name(job_id: str, run: int) -> str:
    """Return the name of a run in handles, by which an executor finds the processes of the run."""
    return f"{job_id}/{run}"


@dataclass(frozen=True, kw_only=True, slots=True)
class Launch:
    """The arguments with which a run process is started."""

    job_id: str
    run: int
    address: str
    token: str
    work_dir: Path
    num_gpus: int = 0
    gpus: tuple[int, ...] = ()
    """Which ones, where the server chooses them."""
    servers: tuple[str, ...] = ()
    """Where the run reaches a server if `address` does not answer, the nearest first."""
    authority: str = ""
    """Certificates (PEM) by which the run checks servers that it reaches over the network."""
    authority_name: str = ""
    """The name in their certificates, if it is not the one in their address."""


def told_in_environment(launch: Launch, settings: Settings) -> dict[str, Any]:
    """Return the contents of `LAMBENT_RUN` but for what only the run's machine knows: folder and memory."""
    return {
        "job_id": launch.job_id,
        "run": launch.run,
        "address": launch.address,
        "servers": list(launch.servers),
        "token": launch.token,
        "authority": launch.authority,
        "authority_name": launch.authority_name,
        "file_bytes": settings.run_file_bytes,
        "processes": settings.run_processes,
        "give_up_after_s": settings.run_give_up_after_s,
        "stop_grace_s": settings.stop_grace_s,
    }


@dataclass(frozen=True, slots=True)
class Gone:
    """The end of a process; `exit_code` is None if unknown, negative for a signal."""

    exit_code: int | None
    not_placed: str = ""
    """Why it never began, if it is known that it did not and that the job is not to blame."""


class Room(Protocol):
    """What is free for further runs, at one moment."""

    def most_gpus(self) -> int | None:
        """Return how many GPUs the next run can have; None if there is no room for any."""

    def take(self, gpus: int) -> tuple[int, ...]:
        """Take the room of a run with so many GPUs; return which, where this is chosen here."""


class Executor(Protocol):
    """Starts, monitors and stops run processes. It keeps no state that a restart must not lose."""

    runs_elsewhere: bool
    """Whether runs are on other machines, and so continue when this one ends."""

    def room(self, own: Sequence[Handle], others: Sequence[Handle]) -> Room:
        """Return what is free beside this server's runs and those of the other servers."""

    def max_gpus(self) -> int:
        """Return how many GPUs a single run can have, if no other run is there."""

    def num_places(self) -> int:
        """Return how many runs without GPUs there is room for, if no other run is there; at least 1."""

    def start(self, launch: Launch) -> Handle:
        """Start a run process; raises OSError if that fails, ExecutorAwayError to try again later."""

    def sees(self, handle: Handle) -> bool:
        """Return whether this executor can tell if the process exists; only then may `poll` be called."""

    def poll(self, handle: Handle, *, has_reported: bool = False) -> Gone | None:
        """Return None while the process exists; raises ExecutorAwayError if that is unknown at present.

        A run that `has_reported` to a server has begun, whatever the executor knows of it.
        """

    def stop(self, handle: Handle, *, force: bool) -> None:
        """Ask the process and its children to exit, or kill them."""

    def adopt(self, handle: Handle) -> bool:
        """Return whether this server can take over the run of a server that died: not if it is tied to it."""

    def runs(self) -> frozenset[str]:
        """Return the names of runs that may still have processes which no job needs any more."""

    def forget(self, run: str) -> None:
        """End what there still is of such a run."""

    def close(self) -> None:
        """Stop monitoring processes, which continue."""
