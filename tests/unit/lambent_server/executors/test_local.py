"""Run processes are found again, get what they need of the environment, and nobody else is ended."""

import contextlib
import json
import signal
import subprocess
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import psutil
import pytest
from lambent_server.core.settings import Settings
from lambent_server.executors import Gone, Handle, Launch, local
from lambent_server.executors.local import LocalExecutor, host_identity, process_identity, run_environment
from support.live_server import wait_until

RUN = {"job_id": "job_x", "run": 1}


def executor(folder: Path, *command: str, **settings: object) -> LocalExecutor:
    return LocalExecutor(Settings(data=folder, run_command=command, **settings))


def launch(folder: Path) -> Launch:
    work_dir = folder / "job_x" / "run-1"
    return Launch(job_id="job_x", run=1, address="unix:/none", token="x", work_dir=work_dir, gpus=(3,))


@contextlib.contextmanager
def session(run: object) -> Iterator[tuple[subprocess.Popen[bytes], psutil.Process]]:
    """Yield the leader of a session and a second process in it, whose environments name a run."""
    leader = subprocess.Popen(
        ["/bin/sh", "-c", "sleep 60 & wait"],
        env={"LAMBENT_RUN": json.dumps(run), "PATH": "/usr/bin:/bin"},
        start_new_session=True,
    )
    member = wait_until(psutil.Process(leader.pid).children)[0]
    try:
        yield leader, member
    finally:
        leader.kill()
        leader.wait()
        with contextlib.suppress(psutil.NoSuchProcess):
            member.kill()


def is_gone(process: psutil.Process) -> bool:
    return not process.is_running() or process.status() == psutil.STATUS_ZOMBIE


def foreign_identities(pid: int) -> dict[str, str]:
    boot, _, rest = str(process_identity(pid)).partition(":")
    namespace, ticks = rest.split(":")
    return {
        "the version before": f"{boot}:{ticks}",
        "another boot or machine": f"{'0' * 36}:{namespace}:{ticks}",
        "another container": f"{boot}:1:{ticks}",
        "an earlier process": f"{boot}:{namespace}:{int(ticks) - 1}",
    }


def test_a_process_that_is_not_proven_to_be_ours_is_left_alone(tmp_path: Path):
    with session({"job_id": "job_y", "run": 1}) as (leader, member):
        for identity in foreign_identities(leader.pid).values():
            handle: Handle = {"pid": leader.pid, "identity": identity, "run": "job_x/1", "gpus": []}
            for each in (handle, {name: handle[name] for name in ("pid", "identity", "gpus")}):
                assert executor(tmp_path).poll(each) == Gone(None)
                executor(tmp_path).stop(each, force=True)
        assert leader.poll() is None
        assert not is_gone(member)


@pytest.mark.parametrize("run", [1, 2])
def test_what_a_run_leaves_is_ended_by_the_run_its_environment_names(tmp_path: Path, run: int):
    with session(RUN) as (leader, member):
        identity = process_identity(leader.pid)
        leader.kill()
        leader.wait()
        handle: Handle = {"pid": leader.pid, "identity": identity, "run": f"job_x/{run}", "gpus": []}
        assert executor(tmp_path).poll({**handle, "identity": f"elsewhere:{identity}"}) == Gone(None)
        assert not is_gone(member)
        assert executor(tmp_path).poll(handle) == Gone(None)
        if run == RUN["run"]:
            wait_until(lambda: is_gone(member), timeout_s=5)
        else:
            assert not is_gone(member)


def test_what_a_child_leaves_is_ended_whatever_its_environment(tmp_path: Path):
    pid = tmp_path / "pid"
    nameless = f"env -i /bin/sh -c 'echo $$ >{pid}; exec sleep 60' &"
    ours = executor(tmp_path, "/bin/sh", "-c", f"{nameless} until [ -s {pid} ]; do sleep 0.01; done; exit 3")
    handle = ours.start(launch(tmp_path))
    assert wait_until(lambda: ours.poll(handle)) == Gone(3)
    left = int(pid.read_text())
    wait_until(lambda: process_identity(left) is None, timeout_s=5)


def test_a_process_is_found_by_another_server_and_ended(tmp_path: Path):
    ours = executor(tmp_path, "sleep", "60")
    handle = json.loads(json.dumps(ours.start(launch(tmp_path))))
    assert handle["gpus"] == [3]
    assert handle["identity"].startswith(host_identity())
    other = executor(tmp_path)
    assert other.poll(handle) is None
    other.stop(handle, force=False)
    assert wait_until(lambda: ours.poll(handle)) == Gone(-signal.SIGTERM)


def test_runs_share_nine_tenths_of_the_memory_where_nothing_else_is_set(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("lambent_server.executors.local.machine_memory_bytes", lambda: 1000)
    ours = executor(tmp_path, "/bin/sh", "-c", 'echo "$LAMBENT_RUN"', local_slots=3)
    handle = ours.start(launch(tmp_path))
    assert wait_until(lambda: ours.poll(handle)) == Gone(0)
    assert json.loads((tmp_path / "job_x" / "run-1.log").read_text())["memory_bytes"] == 300


def test_a_run_process_gets_no_secrets_of_the_server(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    kept = {"OMP_NUM_THREADS": "1", "LC_ALL": "C", "TORCH_HOME": "/t", "HF_HOME": "/h", "PYTHONPATH": "/p"}
    secrets = (
        *("AWS_SECRET_ACCESS_KEY", "AWS_ACCESS_KEY_ID", "AWS_SESSION_TOKEN", "AWS_PROFILE", "DATABASE_URL"),
        *("PGPASSWORD", "PGHOST", "PGUSER", "PGSERVICEFILE", "PGPASSFILE", "HTTPS_PROXY", "SSH_AUTH_SOCK"),
        *("LAMBENT_DATABASE", "LAMBENT_DATABASE_DIRECT", "LAMBENT_API_KEY", "LAMBENT_STORE", "LAMBENT_DATA"),
        *(
            "LAMBENT_STORE_ENDPOINT",
            "LAMBENT_WEBHOOK_ALLOWED",
            "GOOGLE_APPLICATION_CREDENTIALS",
            "GITHUB_TOKEN",
        ),
        # These match a pattern.
        *("NVIDIA_API_KEY", "HF_TOKEN", "PYTHON_REPOSITORY_PASSWORD", "TORCH_SECRET", "XDG_CREDENTIALS"),
    )
    for name, value in {**kept, **dict.fromkeys(secrets, "secret")}.items():
        monkeypatch.setenv(name, value)
    ours = executor(tmp_path, "/usr/bin/env", run_environment=("HF_*",), run_memory_bytes=5)
    handle = ours.start(launch(tmp_path))
    assert wait_until(lambda: ours.poll(handle)) == Gone(0)
    lines = (tmp_path / "job_x" / "run-1.log").read_text().splitlines()
    given = dict(line.split("=", 1) for line in lines)
    assert kept.items() <= given.items()
    assert given["CUDA_VISIBLE_DEVICES"] == "3"
    assert json.loads(given["LAMBENT_RUN"]).items() >= {**RUN, "memory_bytes": 5}.items()
    assert "secret" not in given.values()
    assert [name for name in given if name.startswith("LAMBENT")] == [
        *("LAMBENT_RUN", "LAMBENT_SANDBOX", "LAMBENT_RUN_SLOTS")
    ]


def test_a_secret_that_is_named_letter_by_letter_is_passed_on():
    given = {"HF_TOKEN": "a", "HF_HOME": "b", "HF_SECRET": "c", "NVIDIA_VISIBLE_DEVICES": "0"}
    assert run_environment(given, ("HF_*", "HF_TOKEN")) == {
        name: value for name, value in given.items() if name != "HF_SECRET"
    }


def test_two_who_ask_for_the_end_of_a_run_at_once_both_get_an_answer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(local, "_end_session", lambda *_: time.sleep(0.05))
    runs = executor(tmp_path, "/bin/sh", "-c", "exit 3")
    handle = runs.start(launch(tmp_path))
    wait_until(lambda: process_identity(handle["pid"]) is None)
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda _: runs.poll(handle), range(4)))
    assert sorted(found, key=str) == [Gone(3), *[Gone(None)] * 3]
