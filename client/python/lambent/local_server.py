"""A `lambent serve` of one's own: a child process that is gone when the caller is done with it."""

import contextlib
import json
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from lambent.client import Client
from lambent.errors import LambentError
from lambent.settings import local_url

START_TIMEOUT_S = 60.0
STOP_TIMEOUT_S = 45.0


@dataclass(frozen=True, kw_only=True, slots=True)
class LocalServer:
    """A running server: where it is, its log, and whether it was started here."""

    url: str
    log: Path
    is_ours: bool


@contextlib.contextmanager
def local_server(data: Path) -> Iterator[LocalServer]:
    """Yield the server of a data folder; start one on a free port when none answers, and stop it afterwards.

    Raises `demo.server_failed` with the end of its log when it does not come up within a minute.
    """
    running = _running(data)
    if running is not None:
        yield LocalServer(url=running, log=data / "serve.log", is_ours=False)
        return
    data.mkdir(parents=True, exist_ok=True)
    log = data / "serve.log"
    command = [sys.executable, "-P", "-m", "lambent", "serve", "--data", str(data), "--port", "0"]
    with log.open("wb") as output:
        # A session of its own: Ctrl-C reaches this process only, which then stops the server in order.
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT, start_new_session=True
        )
    try:
        yield LocalServer(url=_wait_until_up(process, data, log), log=log, is_ours=True)
    finally:
        _stop(process)


def _running(data: Path) -> str | None:
    """Return the address of a server that already serves this folder."""
    with contextlib.suppress(LambentError):
        # The address in server.json counts here, not LAMBENT_URL.
        if url := local_url(data):
            with Client(data=data, url=url) as client:
                client.version()
                return client.address.url
    return None


def _wait_until_up(process: subprocess.Popen[bytes], data: Path, log: Path) -> str:
    deadline = time.monotonic() + START_TIMEOUT_S
    while time.monotonic() < deadline and process.poll() is None:
        if (data / "server.json").is_file() and _pid(data) == process.pid:
            url = _running(data)
            if url is not None:
                return url
        time.sleep(0.1)
    last = "\n".join(log.read_text(errors="replace").splitlines()[-12:])
    raise LambentError("demo.server_failed", f"the server did not start:\n{last}", f"its whole log is {log}")


def _pid(data: Path) -> int:
    with contextlib.suppress(ValueError, KeyError, OSError):
        return int(json.loads((data / "server.json").read_text())["pid"])
    return -1


def _stop(process: subprocess.Popen[bytes]) -> None:
    """End the server and everything it started; a second Ctrl-C only shortens the wait."""
    import psutil

    # Run processes have sessions of their own: they are known by their parent while it lives.
    with contextlib.suppress(psutil.NoSuchProcess):
        started = [psutil.Process(process.pid), *psutil.Process(process.pid).children(recursive=True)]
        process.send_signal(signal.SIGINT)
        with contextlib.suppress(subprocess.TimeoutExpired, KeyboardInterrupt):
            process.wait(STOP_TIMEOUT_S)
        for left in started:
            # psutil compares start times, so that a process number used again is left alone.
            with contextlib.suppress(psutil.NoSuchProcess):
                left.kill()
    process.wait()
