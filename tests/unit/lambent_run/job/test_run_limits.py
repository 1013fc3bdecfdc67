"""A run gets an error where it takes more than its share of files, memory or processes."""

import os
import subprocess
import sys
import tempfile
import threading
from pathlib import Path

import pytest
from lambent_run.job.run_limits import count_threads

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not sys.platform.startswith("linux"), reason="other systems limit files only"),
]


def limited(act: str, **limits: int) -> str:
    """Return what a process prints that is limited like a run and does `act` as a user without rights."""
    program = (
        "import os, resource, subprocess, sys, threading\nfrom pathlib import Path\n"
        "from lambent_run.job.connection import Identity\n"
        "from lambent_run.job.run_limits import limit_run\n"
        "if os.geteuid() == 0:\n    os.setgroups([]); os.setgid(65534); os.setuid(54321)\n"
        f"limit_run(Identity(job_id='j', run=1, address='a', token='t', work_dir=Path('/'), **{limits!r}))\n"
        f"{act}\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    return done.stdout.strip()


def test_a_file_ends_at_its_limit_with_an_error():
    with tempfile.TemporaryDirectory() as name:
        Path(name).chmod(0o777)
        large = Path(name) / "large"
        act = (
            f"try:\n    with open({str(large)!r}, 'wb', buffering=0) as file:\n"
            "        while True: file.write(bytes(1000))\nexcept OSError as error:\n    print(error.errno)"
        )
        assert limited(act, file_bytes=5000) == "27"
        assert large.stat().st_size == 5000


def test_threads_and_processes_end_at_their_limit():
    act = (
        "wait = threading.Event(); started = []\n"
        "try:\n    for _ in range(60):\n        each = threading.Thread(target=wait.wait)\n"
        "        each.start(); started.append(each)\n"
        "except RuntimeError:\n    print(len(started))\n"
        "try:\n    subprocess.run(['/bin/true'])\nexcept OSError as error:\n    print(type(error).__name__)\n"
        "wait.set()"
    )
    assert limited(act, processes=20) == "20\nBlockingIOError"
    assert limited(act) == ""


def test_memory_ends_at_its_limit():
    act = "try:\n    bytearray(300 * 2**20)\nexcept MemoryError:\n    print('no more')"
    assert limited(act, memory_bytes=200 * 2**20) == "no more"
    assert limited(act) == ""


def test_no_program_that_a_run_starts_gets_more_rights():
    act = "print([line for line in open('/proc/self/status') if line.startswith('NoNewPrivs')][0].split()[1])"
    assert limited(act) == "1"


def test_the_threads_of_a_user_are_counted():
    before = count_threads(os.getuid())
    waiting = threading.Event()
    more = [threading.Thread(target=waiting.wait) for _ in range(50)]
    for each in more:
        each.start()
    # Other processes of the user come and go meanwhile.
    counted = count_threads(os.getuid())
    waiting.set()
    assert counted >= before + 20
    assert count_threads(59999) == 0
