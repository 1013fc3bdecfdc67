"""How many cores a process uses."""

import os
import subprocess
import sys

import pytest

CORES = len(os.sched_getaffinity(0))


def threads(call: str, **changes: str) -> int:
    """Return how many threads torch would use after `call` in a new process."""
    environment = {k: v for k, v in os.environ.items() if k not in ("OMP_NUM_THREADS", "LAMBENT_RUN_SLOTS")}
    program = (
        f"from lambent_worker.startup import prepare; {call}; import os; print(os.environ['OMP_NUM_THREADS'])"
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
    program = "import os, lambent_worker.startup as s; s.prepare(); print(os.getenv('MALLOC_MMAP_MAX_'))"
    found = subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True)
    assert found.stdout.strip() == "0"
