"""How a server is set up before it answers."""

from pathlib import Path

import pytest
from lambent_server.serving import MAX_SOCKET_PATH, ServeError, worker_address
from lambent_server.settings import Settings


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
