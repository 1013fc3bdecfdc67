"""Control groups for runs (Linux, cgroup v2): one for each, with limits that hold for all its processes.

They need a group that the system has handed over: the server's own is named `server` in it, and the server
may write to it. systemd does that with `Delegate=yes` and `DelegateSubgroup=server`.
"""

import contextlib
import time
from pathlib import Path

import structlog

log = structlog.get_logger()

ROOT = Path("/sys/fs/cgroup")
OWN = Path("/proc/self/cgroup")
_CONTROLLERS = frozenset({"memory", "pids"})
_SERVER = "server"
_PREFIX = "run-"
_TRIES, _WAIT_S = 20, 0.01


class GroupsMissingError(Exception):
    """Runs cannot have groups; the message says why."""


class Groups:
    """Makes, fills and removes groups of runs in a folder of the system."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    @classmethod
    def find(cls, root: Path = ROOT, own: Path = OWN) -> "Groups":
        """Return the groups beside the server's own; raises `GroupsMissingError` where that is impossible."""
        try:
            lines = own.read_text(encoding="utf-8").splitlines()
        except OSError as error:
            raise GroupsMissingError("this system has no control groups") from error
        paths = [line.removeprefix("0::") for line in lines if line.startswith("0::")]
        place = root / paths[0].lstrip("/") if paths else root
        if not paths or not (place / "cgroup.controllers").is_file():
            raise GroupsMissingError("this system has no control groups of version 2")
        if place.name != _SERVER or place == root:
            raise GroupsMissingError("its own group is not named server (DelegateSubgroup=server)")
        folder = place.parent
        try:
            known = (folder / "cgroup.controllers").read_text(encoding="ascii").split()
            if not set(known) >= _CONTROLLERS:
                raise GroupsMissingError(f"only {', '.join(known) or 'nothing'} was handed over")
            control = folder / "cgroup.subtree_control"
            control.write_text(" ".join(f"+{name}" for name in sorted(_CONTROLLERS)), encoding="ascii")
        except OSError as error:
            raise GroupsMissingError(f"{folder}: {error.strerror} (Delegate=yes)") from error
        return cls(folder)

    def place(self, run: str) -> Path:
        """Return the folder of a run's group."""
        return self.folder / (_PREFIX + run.replace("/", "-"))

    def make(self, run: str, *, memory_bytes: int, processes: int) -> Path:
        """Make the group of a run, with limits where they are not 0; raises OSError."""
        place = self.place(run)
        with contextlib.suppress(FileExistsError):
            place.mkdir()
        # With swap, a run that needs more than its memory would slow the machine instead of ending.
        limits = {"memory.max": memory_bytes, "pids.max": processes}
        for name, value in limits.items():
            (place / name).write_text(str(value) if value else "max", encoding="ascii")
        if memory_bytes and (place / "memory.swap.max").exists():
            (place / "memory.swap.max").write_text("0", encoding="ascii")
        return place

    def join(self, run: str, pid: int) -> None:
        """Put a process, and those that it will start, into the group of its run; raises OSError."""
        (self.place(run) / "cgroup.procs").write_text(str(pid), encoding="ascii")

    def sweep(self) -> None:
        """Remove the groups of runs that have ended while no server looked; those in use refuse it."""
        for place in self.folder.glob(f"{_PREFIX}*"):
            with contextlib.suppress(OSError):
                place.rmdir()

    def end(self, run: str) -> None:
        """End all processes of a run and remove its group; one that is not empty yet goes the next time."""
        place = self.place(run)
        if not place.is_dir():
            return
        with contextlib.suppress(OSError):
            (place / "cgroup.kill").write_text("1", encoding="ascii")
        for _ in range(_TRIES):
            with contextlib.suppress(OSError):
                place.rmdir()
                return
            # The last process takes a moment to be gone.
            time.sleep(_WAIT_S)
        log.info("run_group_left", run=run)


def groups_or_none() -> Groups | None:
    """Return the groups; None, and a line in the log, where runs cannot have any."""
    try:
        groups = Groups.find()
    except GroupsMissingError as error:
        log.info("run_groups_missing", reason=str(error), instead="limits of each process")
        return None
    groups.sweep()
    log.info("run_groups", folder=str(groups.folder))
    return groups
