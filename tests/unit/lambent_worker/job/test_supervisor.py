"""A supervisor waits for a server that is away, and not for one that will not come back."""

import json
import os
import shutil
import signal
import sys
from pathlib import Path

import pytest
from lambent_worker.job import supervisor
from lambent_worker.job.exit_codes import EXIT_UNREACHABLE


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
    monkeypatch.setattr(supervisor, "FIRST_HEARTBEAT_S", 0.1)
    monkeypatch.setattr(signal, "signal", lambda *_: None)
    work_dir = tmp_path / "job_x" / "run-1"
    work_dir.mkdir(parents=True)
    run = {"job_id": "job_x", "run": 1, "address": f"unix:{tmp_path}/s", "token": "x", "memory_bytes": 0}
    run |= {"work_dir": str(work_dir), "give_up_after_s": give_up_after_s}
    monkeypatch.setenv("LAMBENT_RUN", json.dumps(run))
    if not folder_stays:
        shutil.rmtree(tmp_path / "job_x")
    assert supervisor.supervise([sys.executable, "-S", "-c", f"import time; time.sleep({sleep_s})"]) == code


def test_the_run_process_is_told_whose_child_it_is(monkeypatch):
    """A child that starts after its parent's death has to notice; the signal comes too late for that."""
    started = []

    def popen(command, **options):
        started.append(options["env"])
        raise OSError("only the environment is looked at")

    run = {"job_id": "job_x", "run": 1, "address": "unix:/nowhere", "token": "x", "memory_bytes": 0}
    monkeypatch.setenv("LAMBENT_RUN", json.dumps(run | {"work_dir": "/nowhere", "give_up_after_s": 1.0}))
    monkeypatch.setattr(supervisor.subprocess, "Popen", popen)
    with pytest.raises(OSError, match="environment"):
        supervisor.supervise([sys.executable])
    assert started[0]["LAMBENT_PARENT_PID"] == str(os.getpid())
