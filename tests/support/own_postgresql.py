"""A PostgreSQL cluster of a test's own, which it may stop as a power failure would."""

import contextlib
import os
import pwd
import shutil
import socket
import subprocess
import tempfile
from pathlib import Path
from types import TracebackType
from typing import Self

import pytest

_VERSIONS = Path("/usr/lib/postgresql")


def programs() -> Path | None:
    """Return the folder of initdb and pg_ctl: that of the newest version that is installed, or None."""
    found = sorted(_VERSIONS.glob("*/bin/initdb"), key=lambda path: float(path.parts[-3]))
    if found:
        return found[-1].parent
    path = shutil.which("initdb")
    return None if path is None else Path(path).resolve().parent


class OwnPostgreSQL:
    """One cluster; stopped and started again, it has the same address and data.

    As root it runs as another user, because PostgreSQL refuses to run as root.
    """

    def __init__(self) -> None:
        """Make the cluster; the test is skipped where PostgreSQL's programs are not installed."""
        found = programs()
        if found is None:
            pytest.skip("PostgreSQL's programs (initdb, pg_ctl) are not installed on this machine")
        self._bin = found
        self._user = None
        # Not below pytest's folders, which other users may not enter.
        self._folder = Path(tempfile.mkdtemp(prefix="lambent-postgresql-"))
        if os.geteuid() == 0:
            names = {entry.pw_name for entry in pwd.getpwall()}
            self._user = "postgres" if "postgres" in names else "nobody"
            shutil.chown(self._folder, self._user)
        options = ("--auth=trust", "--username=postgres", "--encoding=UTF8", "--no-sync")
        self._run("initdb", *options, "-D", str(self._folder / "data"))
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self.port = probe.getsockname()[1]
        self.url = f"postgresql://postgres@127.0.0.1:{self.port}/postgres"

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        # A test may have left it stopped.
        with contextlib.suppress(subprocess.CalledProcessError):
            self.stop()
        shutil.rmtree(self._folder)

    def start(self) -> None:
        """Start it, and wait until it answers."""
        options = f"-p {self.port} -c listen_addresses=127.0.0.1 -c unix_socket_directories={self._folder}"
        options += " -c max_connections=200"
        self._control("start", "-w", "-t", "120", "-l", str(self._folder / "log"), "-o", options)

    def stop(self, how: str = "immediate") -> None:
        """Stop it: "immediate" as a power failure would, "fast" in order."""
        self._control("stop", "-w", "-m", how)

    def _control(self, *arguments: str) -> None:
        self._run("pg_ctl", "-D", str(self._folder / "data"), *arguments)

    def _run(self, program: str, *arguments: str) -> None:
        with (self._folder / "control.log").open("ab") as log:
            subprocess.run(
                [str(self._bin / program), *arguments],
                check=True,
                user=self._user,
                cwd="/",
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
            )
