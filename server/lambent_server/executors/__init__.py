"""Executors, which start run processes: the protocol, and one module for each kind."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

# How an executor finds a process; stored in the job's row, so it is JSON and survives the server. Before
# the process exists it has only `gpus`: they are taken as soon as the row says that the job runs.
Handle = dict[str, Any]


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
    gpus: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class Gone:
    """The end of a process; `exit_code` is None if unknown, negative for a signal."""

    exit_code: int | None


class Executor(Protocol):
    """Starts, monitors and stops run processes. It keeps no state that a restart must not lose."""

    def start(self, launch: Launch) -> Handle:
        """Start a run process; raises OSError if that fails."""

    def poll(self, handle: Handle) -> Gone | None:
        """Return None while the process exists."""

    def stop(self, handle: Handle, *, force: bool) -> None:
        """Ask the process and its children to exit, or kill them."""

    def adopt(self, handle: Handle) -> bool:
        """Monitor a process that another server started; return whether it still exists."""
