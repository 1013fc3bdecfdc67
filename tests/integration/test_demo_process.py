"""The demo as a process: however it ends, it leaves no process behind, and the next one resumes."""

import contextlib
import json
import os
import signal
import subprocess
import sys

import psutil
import pytest
from lambent import Client
from lambent.local_server import local_server
from support.live_server import wait_until

pytestmark = pytest.mark.slow


RUN = ["sleep", "617"]


@pytest.fixture
def environment(monkeypatch):
    """Return an environment in which a server's run processes only sleep."""
    for name, value in {"RUN_COMMAND": json.dumps(RUN), "TICK_S": "0.05", "STOP_GRACE_S": "2"}.items():
        monkeypatch.setenv(f"LAMBENT_{name}", value)
    return dict(os.environ)


def descendants(process):
    """Return everything the process has started, once a run is among it."""

    def found():
        started = psutil.Process(process.pid).children(recursive=True)
        return started if any(each.cmdline() == RUN for each in started if each.is_running()) else None

    return wait_until(found, 60)


def alive(processes):
    return [p for p in processes if p.is_running() and p.status() != psutil.STATUS_ZOMBIE]


def test_ending_the_demo_leaves_nothing_running_and_the_same_job_goes_on(tmp_path, environment):
    words = [sys.executable, "-m", "lambent", "demo", "--no-keep", "--json", "-o", str(tmp_path)]
    log = tmp_path / "demo.log"
    jobs = []
    for number in (signal.SIGINT, signal.SIGTERM):
        with log.open("wb") as output:
            process = subprocess.Popen(words, env=environment, stdout=output, stderr=subprocess.STDOUT)
        started = []
        try:
            wait_until(lambda: log.read_text().startswith('{"job"'), 60)
            started = descendants(process)
            process.send_signal(number)
            assert process.wait(60) == 130
            assert alive(started) == []
        finally:
            if process.poll() is None:
                started += psutil.Process(process.pid).children(recursive=True)
            for left in started:
                with contextlib.suppress(psutil.NoSuchProcess):
                    left.kill()
            process.kill()
            process.wait()
        jobs.append(json.loads(log.read_text().splitlines()[0])["job"]["id"])
    assert jobs[0] == jobs[1]


def test_a_server_that_already_serves_the_folder_is_used_and_left_alone(tmp_path, environment):
    with local_server(tmp_path) as first:
        assert first.is_ours
        with local_server(tmp_path) as second:
            assert second.url == first.url
            assert not second.is_ours
        with Client(first.url, data=tmp_path) as client:
            assert client.version()["name"] == "lambent"
    assert not (tmp_path / "server.json").exists()
