"""Several servers on one database put, sweep and read the same blobs: no row is ever without bytes."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from support import blob_stress
from support.databases import postgresql

SECONDS = 6


def stress(folder: Path, database: str, store: str | None = None) -> dict[str, int]:
    """Run two processes for some seconds and return what they did together."""
    command = [sys.executable, blob_stress.__file__]
    more = [] if store is None else [store]
    both = [
        subprocess.Popen(
            [*command, str(folder / f"data{seed}"), database, str(seed), str(SECONDS), *more],
            stdout=subprocess.PIPE,
            text=True,
        )
        for seed in range(2)
    ]
    try:
        printed = [process.communicate(timeout=300)[0] for process in both]
    finally:
        for process in both:
            process.kill()
            process.wait()
    assert [process.returncode for process in both] == [0, 0]
    counts = [json.loads(each) for each in printed]
    return {name: sum(count.get(name, 0) for count in counts) for name in counts[0]}


@pytest.mark.services
@pytest.mark.slow
@pytest.mark.timeout(600)
def test_two_processes_that_put_sweep_and_read_never_leave_a_row_without_bytes(tmp_path: Path):
    with postgresql() as database:
        # Migrates before both begin.
        services = blob_stress.services_of(tmp_path / "data", database, None)
        counts = stress(tmp_path, database)
        for tenant in blob_stress.TENANTS:
            for content in blob_stress.CONTENTS:
                blob_stress.check(services, tenant, content)
        services.database.close()
    assert min(counts["removed"], counts["found"]) >= 2 * blob_stress.ENOUGH, counts
