"""A supervisor waits for a server that does not answer, and not for one that will not come back."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from lambent_proto.v1 import worker_pb2
from lambent_run import __main__ as program
from lambent_run.job import supervisor
from lambent_run.job.connection import EXIT_FENCED, EXIT_UNREACHABLE, FencedError, Identity
from lambent_server.core.settings import Settings


class FakeConnection:
    """Answers as a test says, and notes what it receives."""

    def __init__(self, identity: Identity, answer: Callable[[str], Any]) -> None:
        self.identity = identity
        self.ending = False
        self.learnt: list[list[str]] = []
        self.failures: list[Any] = []
        self.stub = SimpleNamespace(
            Register="Register",
            Heartbeat="Heartbeat",
            Fail="Fail",
            learn=lambda servers: self.learnt.append(list(servers)),
        )
        self._answer = answer

    def once(self, method: str, _request: Any) -> Any:
        return self._answer(method)

    def call(self, _method: str, request: Any) -> None:
        self.failures.append(request)

    def close(self) -> None:
        pass


def started(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, **identity: Any) -> None:
    """Let this process be the one that a server starts for a run, in a folder of its own."""
    work_dir = tmp_path / "job_x" / "run-1"
    work_dir.mkdir(parents=True)
    run = {"job_id": "job_x", "run": 1, "address": f"unix:{tmp_path}/s", "token": "x"}
    monkeypatch.setenv("LAMBENT_RUN", json.dumps({**run, "work_dir": str(work_dir), **identity}))
    monkeypatch.setattr(signal, "signal", lambda *_: None)
    monkeypatch.setattr(supervisor, "FIRST_HEARTBEAT_S", 0.05)


def supervised(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    code: str,
    answer: Callable[[str], Any],
    **identity: Any,
) -> tuple[int, FakeConnection]:
    """Watch a program with a server that answers so; return the exit code, and the connection."""
    started(tmp_path, monkeypatch, **identity)
    made: list[FakeConnection] = []

    def connect(identity: Identity) -> FakeConnection:
        made.append(FakeConnection(identity, answer))
        return made[-1]

    monkeypatch.setattr(supervisor, "Connection", connect)
    return supervisor.supervise([sys.executable, "-S", "-c", code]), made[0]


def register_response(**more: Any) -> worker_pb2.RegisterResponse:
    return worker_pb2.RegisterResponse(heartbeat_s=0.05, **more)


def test_a_pipeline_that_does_not_end_when_told_is_killed_after_the_grace_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """Also where no server is left that sees the process."""
    ready = tmp_path / "ready"
    deaf = "import pathlib, signal, time; signal.signal(signal.SIGTERM, signal.SIG_IGN);"
    deaf += f"pathlib.Path({str(ready)!r}).touch(); time.sleep(15)"
    told: list[float] = []

    def answer(method: str) -> Any:
        if method == "Register":
            return register_response()
        if ready.exists():
            told.append(time.monotonic())
        return worker_pb2.HeartbeatResponse(stop=ready.exists())

    code, connection = supervised(tmp_path, monkeypatch, deaf, answer, stop_grace_s=0.4)
    assert 0.4 <= time.monotonic() - told[0] < 10.0
    # Every answer says that it has to end as long as it lives.
    assert len(told) > 2
    (failure,) = connection.failures
    assert (code, failure.cause, connection.ending) == (0, worker_pb2.FAIL_CAUSE_KILLED, True)


@pytest.mark.parametrize(
    ("then", "expected", "word"),
    [
        ("pass", 0, ""),
        ("time.sleep(30)", EXIT_FENCED, "fenced: it has ended"),
        ("raise SystemExit(2)", EXIT_FENCED, "fenced: it has ended"),
    ],
    ids=["has succeeded", "continues", "fails"],
)
def test_a_child_that_ends_well_as_its_run_has_ended_is_not_called_fenced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: Any, then: str, expected: int, word: str
):
    """A heartbeat may come between the child's last message and its end."""
    told = tmp_path / "told"

    def answer(method: str) -> Any:
        if method == "Register":
            return register_response()
        told.touch()
        raise FencedError("it has ended")

    monkeypatch.setattr(supervisor, "FENCED_GRACE_S", 5.0 if expected == 0 else 0.5)
    code = f"import os, time\nwhile not os.path.exists({str(told)!r}): time.sleep(0.01)\n{then}"
    assert supervised(tmp_path, monkeypatch, code, answer)[0] == expected
    assert capfd.readouterr().err.strip() == word


def test_a_run_learns_of_other_servers_as_soon_as_it_registers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    def answer(method: str) -> Any:
        if method == "Register":
            return register_response(servers=["unix:/s", "tls:there:1"])
        return worker_pb2.HeartbeatResponse()

    _, connection = supervised(tmp_path, monkeypatch, "import time; time.sleep(0.3)", answer)
    assert connection.learnt[0] == ["unix:/s", "tls:there:1"]


def test_the_time_without_a_server_begins_anew_with_every_answer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    calls: list[str] = []

    def answer(method: str) -> Any:
        calls.append(method)
        # Every other call finds nobody.
        return register_response() if len(calls) % 2 else None

    work = "import time; time.sleep(1.2)"
    code, _ = supervised(tmp_path, monkeypatch, work, answer, give_up_after_s=0.6)
    assert code == 0
    assert len(calls) > 10


@pytest.mark.parametrize(
    ("give_up_after_s", "folder_stays", "sleep_s", "code"),
    [(0.3, True, 60, EXIT_UNREACHABLE), (60.0, False, 60, EXIT_UNREACHABLE), (60.0, True, 0.5, 0)],
)
def test_a_run_without_a_server_ends_with_its_folder_or_its_time(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    give_up_after_s: float,
    folder_stays: bool,
    sleep_s: float,
    code: int,
):
    started(tmp_path, monkeypatch, give_up_after_s=give_up_after_s)
    if not folder_stays:
        shutil.rmtree(tmp_path / "job_x")
    assert supervisor.supervise([sys.executable, "-S", "-c", f"import time; time.sleep({sleep_s})"]) == code


def test_the_run_process_is_told_whose_child_it_is(tmp_path, monkeypatch):
    """A child that starts after its parent's death has to notice; the signal comes too late for that."""
    environments = []

    def popen(command, **options):
        environments.append(options["env"])
        raise OSError("only the environment is looked at")

    started(tmp_path, monkeypatch)
    monkeypatch.setattr(supervisor.subprocess, "Popen", popen)
    with pytest.raises(OSError, match="environment"):
        supervisor.supervise([sys.executable])
    assert environments[0]["LAMBENT_PARENT_PID"] == str(os.getpid())


def test_neither_part_of_a_run_looks_for_modules_in_the_working_directory(tmp_path, monkeypatch):
    started = []
    monkeypatch.setattr(program, "supervise", lambda command: started.append(command) or 0)
    assert program.main(["run"]) == 0
    (tmp_path / "lambent_run").mkdir()
    (tmp_path / "lambent_run" / "__init__.py").write_text("print('foreign', flush=True)")
    for command in (started[0], Settings().run_command):
        # Without its last word it tells how it is used.
        done = subprocess.run(command[:-1], cwd=tmp_path, capture_output=True, text=True, check=False)
        assert (done.returncode, done.stdout) == (2, "")
        assert done.stderr.startswith("usage:")
