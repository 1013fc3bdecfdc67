"""Where run processes live: the protocol, and one module for each kind."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

# What an executor finds a process by; kept in the job's row, so it is JSON and survives the server. Before
# the process is known it has `gpus` only: they are taken from the moment the row says that the job runs.
Handle = dict[str, Any]


def run_name(job_id: str, run: int) -> str:
    """Return what a run is called in handles; an executor finds by it what belongs to a run."""
    return f"{job_id}/{run}"


@dataclass(frozen=True, kw_only=True, slots=True)
class Launch:
    """What a run process is started with."""

    job_id: str
    run: int
    address: str
    token: str
    work_dir: Path
    gpus: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class Gone:
    """The process has ended; `exit_code` is None where nobody saw how, negative for a signal."""

    exit_code: int | None


class Executor(Protocol):
    """Starts, watches and ends run processes. It keeps nothing that a restart may not lose."""

    def start(self, launch: Launch) -> Handle:
        """Start a run process; OSError where that is impossible."""

    def poll(self, handle: Handle) -> Gone | None:
        """Return None while the process is there."""

    def stop(self, handle: Handle, *, force: bool) -> None:
        """Ask the process and its children to end, or end them."""

    def adopt(self, handle: Handle) -> bool:
        """Watch a process that another server started; return whether it is still there."""
