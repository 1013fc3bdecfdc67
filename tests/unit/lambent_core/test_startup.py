"""The number of cores that a process uses."""

import os
import signal
import subprocess
import sys

import pytest

CORES = len(os.sched_getaffinity(0))


def threads(call: str, **changes: str) -> int:
    """Return how many threads torch would use after `call` in a new process."""
    environment = {k: v for k, v in os.environ.items() if k not in ("OMP_NUM_THREADS", "LAMBENT_RUN_SLOTS")}
    program = (
        f"from lambent_core.startup import prepare; {call}; import os; print(os.environ['OMP_NUM_THREADS'])"
    )
    command = [sys.executable, "-c", program]
    return int(subprocess.run(command, env=environment | changes, check=True, capture_output=True).stdout)


@pytest.mark.parametrize(
    ("call", "changes", "expected"),
    [
        ("prepare()", {}, CORES),
        ("prepare()", {"OMP_NUM_THREADS": "7"}, 7),
        ("prepare(3)", {"OMP_NUM_THREADS": "7"}, 3),
        ("prepare()", {"LAMBENT_RUN_SLOTS": str(CORES)}, 1),
        ("prepare()", {"LAMBENT_RUN_SLOTS": str(3 * CORES)}, 1),
        ("prepare(5)", {"LAMBENT_RUN_SLOTS": "2"}, 5),
    ],
)
def test_a_run_uses_its_share_of_the_cores_unless_told_otherwise(call, changes, expected):
    assert threads(call, **changes) == expected


def test_processes_that_are_started_keep_freed_memory_too():
    program = "import os, lambent_core.startup as s; s.prepare(); print(os.getenv('MALLOC_MMAP_MAX_'))"
    found = subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True)
    assert found.stdout.strip() == "0"


CHILD = """
import os, signal, sys
from lambent_core.startup import end_with_parent
end_with_parent(signal.SIGKILL)
print(sys.argv[1], os.environ.get("LAMBENT_PARENT_PID"))
"""
PARENT = f"""
import subprocess, sys
from lambent_core.startup import with_parent
subprocess.run([sys.executable, "-c", {CHILD!r}, "alive"], env=with_parent(), check=True)
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="signals at a parent's death are Linux's")
def test_a_process_ends_if_its_parent_is_gone_before_it_is_ready():
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    orphan = [sys.executable, "-c", CHILD, "alive"]
    late = subprocess.run(orphan, env=os.environ | {"LAMBENT_PARENT_PID": str(gone.pid)}, check=False)
    assert late.returncode == -signal.SIGKILL
    # With its parent there it continues, and its own children are not told of a grandparent.
    done = subprocess.run([sys.executable, "-c", PARENT], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["alive", "None"]
