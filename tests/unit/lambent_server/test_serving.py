"""The set-up of a server before it answers."""

import asyncio
import os
import resource
import signal
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from lambent_server.core.settings import ServeError, Settings
from lambent_server.serving import (
    MIN_CONNECTIONS,
    OTHER_FILES,
    allow_connections,
    end_signal,
)
from lambent_server.workers.link import MAX_SOCKET_PATH, worker_address


def test_a_long_data_folder_gets_a_socket_that_no_other_user_reaches(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    short = tmp_path / "t"
    short.mkdir()
    monkeypatch.setattr("tempfile.gettempdir", lambda: str(short))
    long = Settings(data=tmp_path / ("x" * MAX_SOCKET_PATH))
    address = worker_address(long)
    socket = Path(address.removeprefix("unix:"))
    assert address.startswith("unix:")
    assert socket.parent.parent == short
    assert socket.parent.stat().st_mode & 0o777 == 0o700
    # Run processes find the next server where they found this one.
    assert worker_address(long) == address
    assert worker_address(Settings(data=tmp_path / ("y" * MAX_SOCKET_PATH))) != address
    socket.parent.chmod(0o755)
    with pytest.raises(ServeError, match=r"serve\.folder_not_private"):
        worker_address(long)


@pytest.fixture
def usual_signals() -> Iterator[None]:
    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.usefixtures("usual_signals")
def test_a_signal_is_not_lost_among_the_news_of_thousands_of_connections():
    async def body() -> int:
        loop = asyncio.get_running_loop()
        ended = end_signal(loop)

        def flood() -> None:
            # As Granian's threads do for every connection with news, while the loop is busy.
            for _ in range(5000):
                loop.call_soon_threadsafe(int)
            os.kill(os.getpid(), signal.SIGTERM)

        flooding = threading.Thread(target=flood)
        flooding.start()
        flooding.join()
        return await asyncio.wait_for(ended, 5.0)

    assert asyncio.run(body()) == signal.SIGTERM


def test_fewer_open_files_are_fewer_connections(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    settings = Settings(data=tmp_path, max_connections=1000, max_bodies=100, max_requests=100)
    needed = 1200 + OTHER_FILES
    limits = {"soft": 256, "hard": needed}
    monkeypatch.setattr(resource, "getrlimit", lambda _: (limits["soft"], limits["hard"]))
    monkeypatch.setattr(resource, "setrlimit", lambda _, given: limits.update(soft=given[0]))
    assert allow_connections(settings) == 1000
    # Every upload has a file besides its connection.
    assert limits["soft"] == needed
    limits |= {"soft": 256, "hard": OTHER_FILES + 600}
    assert allow_connections(settings) == 500
    assert limits["soft"] == OTHER_FILES + 600
    limits |= {"soft": 256, "hard": 300}
    assert allow_connections(settings) == MIN_CONNECTIONS
