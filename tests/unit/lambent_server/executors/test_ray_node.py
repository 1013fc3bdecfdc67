"""An actor on its node, without Ray."""

import inspect
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from lambent_server.executors import installed, ray_node
from support.live_server import wait_until

SLEEP = "import os, time; print('begun', flush=True); time.sleep(600)"


def launch(folder: Path, code: str = SLEEP, **more: Any) -> dict[str, Any]:
    given = {
        "job_id": "job_a",
        "run": 2,
        "namespace": "ours",
        "folder": str(folder),
        "command": [None, "-c", code],
        "environment": ["PATH", "PYTHON*", "HF_*", "LAMBENT_TEST_SESSION"],
        "named": ["HF_TOKEN"],
        "secret": "(?i)token",
        "sandbox": "available",
        "memory_bytes": 123,
        "needs": {"cpus": 1.0, "gpus": 1, "memory_bytes": 123},
        "installed": None,
        "installed_code": "",
        "identity": {"job_id": "job_a", "run": 2, "token": "t"},
    }
    return {**given, **more}


@pytest.fixture
def holders(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """Yield what makes a holder; whatever it has started is ended."""
    monkeypatch.setattr(ray_node, "_given_place", lambda: ("node", [3]))
    # It would end this process, ten minutes after the run.
    monkeypatch.setattr(ray_node, "_leave_after", lambda pid: None)
    made: list[ray_node.RunHolder] = []

    def make(given: dict[str, Any]) -> ray_node.RunHolder:
        made.append(ray_node.RunHolder(given))
        return made[-1]

    yield make
    for holder in made:
        holder.signal(signal.SIGKILL)
        if holder._child is not None:
            holder._child.wait()
        if holder._lock is not None:
            holder._lock.close()


def log_of(holder: ray_node.RunHolder) -> str:
    return holder._log.read_text()


def test_a_run_gets_its_gpus_and_the_variables_that_are_named(
    holders: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    for name in ("HF_TOKEN", "HF_HOME", "HF_OTHER_TOKEN", "RAY_AUTH_TOKEN", "OMP_NUM_THREADS"):
        monkeypatch.setenv(name, "1")
    holder = holders(launch(tmp_path / "x", "import os; print(sorted(os.environ))"))
    wait_until(lambda: holder.status(-1)["exit_code"] == 0)
    assert "HF_TOKEN" in log_of(holder)
    assert "HF_HOME" in log_of(holder)
    assert not [name for name in ("HF_OTHER", "RAY_", "OMP_NUM") if name in log_of(holder)]
    assert holder.status(0)["gpus"] == [3]


def test_output_is_sent_from_where_it_is_wanted(holders: Any, tmp_path: Path):
    holder = holders(launch(tmp_path / "x", "print('0123456789', end='')"))
    wait_until(lambda: holder.status(-1)["exit_code"] == 0)
    status = holder.status(4)
    assert (status["offset"], status["log_left"]) == (4, 0)
    assert status["log"] == "NDU2Nzg5"
    # Nobody has asked for it yet.
    assert (holder.status(-1)["log"], holder.status(-1)["log_left"]) == ("", 10)


def test_the_end_is_told_and_takes_the_rest_of_the_session_along(holders: Any, tmp_path: Path):
    code = "import subprocess, sys; p = subprocess.Popen(['sleep', '600']); print(p.pid); sys.exit(7)"
    holder = holders(launch(tmp_path / "x", code))
    wait_until(lambda: holder.status(-1)["exit_code"] == 7)
    rest = int(log_of(holder))
    wait_until(lambda: not _exists(rest))


def test_a_run_is_signalled_as_a_group(holders: Any, tmp_path: Path):
    holder = holders(launch(tmp_path / "x"))
    wait_until(lambda: "begun" in log_of(holder))
    holder.signal(signal.SIGTERM)
    wait_until(lambda: holder.status(-1)["exit_code"] == -signal.SIGTERM)


def test_leaving_ends_the_run_and_removes_its_files(
    holders: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    ray = pytest.importorskip("ray")
    monkeypatch.setattr(ray.actor, "exit_actor", lambda: None)
    first, second = holders(launch(tmp_path / "x")), holders(launch(tmp_path / "x", run=3))
    first.leave()
    assert first._child is not None
    assert not _exists(first._child.pid)
    left = sorted(path.name for path in (tmp_path / "x" / "ours" / "job_a").iterdir())
    assert left == ["run-3", "run-3.lock", "run-3.log"]
    second.leave()
    assert not (tmp_path / "x" / "ours" / "job_a").exists()


def test_folders_that_a_killed_actor_left_are_removed_and_no_others(holders: Any, tmp_path: Path):
    root = tmp_path / "x" / "ours"
    holder = holders(launch(tmp_path / "x", job_id="job_alive"))
    for name in ("job_old", "job_new"):
        (root / name / "run-1").mkdir(parents=True)
        (root / name / "run-1.lock").touch()
    long_ago = time.time() - 7200
    for name in ("job_old", "job_alive"):
        os.utime(root / name, (long_ago, long_ago))
    holders(launch(tmp_path / "x", job_id="job_next"))
    assert sorted(path.name for path in root.iterdir()) == ["job_alive", "job_new", "job_next", "lock"]
    assert holder.status(-1)["exit_code"] is None


def test_another_version_is_refused_and_the_same_is_not(holders: Any, tmp_path: Path):
    found, code = installed.installed(), inspect.getsource(installed)
    same = holders(launch(tmp_path / "x", installed=found, installed_code=code))
    assert same.status(-1)["refused"] == ""
    other = {"version": "9.9", "digest": "0" * 64}
    differs = holders(launch(tmp_path / "y", installed=other, installed_code=code))
    assert f"version {found['version']} ({found['digest'][:12]})" in differs.status(-1)["refused"]
    assert "the server has 9.9 (000000000000)" in differs.status(-1)["refused"]
    assert differs._child is None
    none = holders(launch(tmp_path / "z", installed=other, installed_code='print(\'{"version": ""}\')'))
    assert "[worker] is not installed" in none.status(-1)["refused"]


def test_a_folder_in_which_others_can_write_is_refused(holders: Any, tmp_path: Path):
    (tmp_path / "open").mkdir()
    (tmp_path / "open").chmod(0o777)
    holder = holders(launch(tmp_path / "open"))
    assert "no one else can write" in holder.status(-1)["refused"]
    assert holder._lock is None


@pytest.mark.skipif(sys.platform != "linux", reason="asks the kernel of Linux")
def test_a_run_ends_with_its_actor(tmp_path: Path):
    code = (
        "import sys, time; from lambent_server.executors import ray_node\n"
        "ray_node._given_place = lambda: ('node', [])\n"
        f"holder = ray_node.RunHolder({launch(tmp_path / 'x')!r})\n"
        "print(holder.status(-1)['pid'], flush=True)\n"
        "time.sleep(600)"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE) as actor:
        assert actor.stdout is not None
        pid = int(actor.stdout.readline())
        wait_until(lambda: "begun" in (tmp_path / "x" / "ours" / "job_a" / "run-2.log").read_text())
        assert _exists(pid)
        actor.kill()
    wait_until(lambda: not _exists(pid))


def _exists(pid: int) -> bool:
    try:
        with open(f"/proc/{pid}/stat", encoding="ascii") as file:
            return file.read().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False
