"""Runs get control groups where the system has handed some over, and only there."""

import os
import subprocess
from pathlib import Path

import pytest
from lambent_server.core.settings import Settings
from lambent_server.executors import Gone, Launch
from lambent_server.executors.groups import Groups, GroupsMissingError
from lambent_server.executors.local import LocalExecutor
from support.live_server import wait_until

UNIFIED = Path("/sys/fs/cgroup/unified")


def launch(folder: Path) -> Launch:
    work_dir = folder / "job_x" / "run-1"
    return Launch(job_id="job_x", run=1, address="unix:/none", token="x", work_dir=work_dir)


def tree(
    folder: Path, place: str = "/lambent.service/server", controllers: str = "cpu memory pids"
) -> Groups:
    """Return the groups of a tree of plain files that looks like the system's."""
    own = folder / "own"
    own.write_text(f"1:name=systemd:/x\n0::{place}\n")
    root = folder / "root"
    for each in (root / place.lstrip("/"), (root / place.lstrip("/")).parent):
        each.mkdir(parents=True, exist_ok=True)
        (each / "cgroup.controllers").write_text(controllers + "\n")
        (each / "cgroup.subtree_control").write_text("")
    return Groups.find(root, own)


def test_the_group_beside_the_servers_is_used_and_its_controllers_are_turned_on(tmp_path: Path):
    groups = tree(tmp_path)
    assert groups.folder == tmp_path / "root" / "lambent.service"
    assert (groups.folder / "cgroup.subtree_control").read_text() == "+memory +pids"


@pytest.mark.parametrize(
    ("place", "controllers", "reason"),
    [
        ("/lambent.service", "memory pids", "not named server"),
        ("/", "memory pids", "not named server"),
        ("/lambent.service/server", "cpu", "only cpu was handed over"),
        ("/lambent.service/server", "", "only nothing was handed over"),
    ],
)
def test_without_groups_of_its_own_a_server_says_what_is_missing(
    tmp_path: Path, place: str, controllers: str, reason: str
):
    with pytest.raises(GroupsMissingError, match=reason):
        tree(tmp_path, place, controllers)


def test_a_system_without_groups_is_told(tmp_path: Path):
    with pytest.raises(GroupsMissingError, match="no control groups"):
        Groups.find(tmp_path, tmp_path / "none")
    (tmp_path / "own").write_text("4:memory:/x\n")
    with pytest.raises(GroupsMissingError, match="version 2"):
        Groups.find(tmp_path, tmp_path / "own")


def test_a_run_is_put_into_a_group_with_its_limits(tmp_path: Path):
    groups = tree(tmp_path)
    settings = Settings(
        data=tmp_path, run_command=("/bin/sh", "-c", "exit 3"), run_memory_bytes=7_000_000, run_processes=50
    )
    ours = LocalExecutor(settings, groups)
    handle = ours.start(launch(tmp_path))
    place = groups.place("job_x/1")
    given = {name: (place / name).read_text() for name in ("memory.max", "pids.max", "cgroup.procs")}
    assert given == {"memory.max": "7000000", "pids.max": "50", "cgroup.procs": str(handle["pid"])}
    assert wait_until(lambda: ours.poll(handle)) == Gone(3)
    assert (place / "cgroup.kill").read_text() == "1"


def test_without_limits_a_group_has_none(tmp_path: Path):
    place = tree(tmp_path).make("job_x/1", memory_bytes=0, processes=0)
    assert (place / "memory.max").read_text() == (place / "pids.max").read_text() == "max"


def test_a_group_that_cannot_be_made_does_not_keep_a_run_from_starting(tmp_path: Path):
    groups = tree(tmp_path)
    groups.place("job_x/1").parent.rename(tmp_path / "gone")
    ours = LocalExecutor(Settings(data=tmp_path, run_command=("/bin/sh", "-c", "exit 3")), groups)
    handle = ours.start(launch(tmp_path))
    assert wait_until(lambda: ours.poll(handle)) == Gone(3)


@pytest.mark.skipif(not os.access(UNIFIED, os.W_OK), reason="needs a writable tree of groups (version 2)")
def test_the_end_of_a_run_takes_all_its_processes_with_it():
    groups = Groups(UNIFIED)
    run = f"test-{os.getpid()}/1"
    place = groups.place(run)
    place.mkdir()
    try:
        # Its leader ends; a process of another session that belongs to the run remains.
        leader = subprocess.Popen(
            ["/bin/sh", "-c", "read go; setsid sleep 60 & echo $!"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={"PATH": "/usr/bin:/bin", "LAMBENT_TEST_SESSION": os.environ["LAMBENT_TEST_SESSION"]},
        )
        groups.join(run, leader.pid)
        assert leader.stdin is not None
        assert leader.stdout is not None
        leader.stdin.write(b"go\n")
        leader.stdin.close()
        left = int(leader.stdout.readline())
        leader.wait()
        assert str(left) in (place / "cgroup.procs").read_text().split()
        groups.end(run)
        wait_until(lambda: not (place / "cgroup.procs").read_text().split() if place.exists() else True)
        leader.stdout.close()
    finally:
        if place.exists():
            groups.end(run)
