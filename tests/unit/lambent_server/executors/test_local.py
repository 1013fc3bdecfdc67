import os
import sys
import time

import pytest
from lambent_server.executors import Gone, Launch
from lambent_server.executors.local import LocalExecutor, process_identity


def launch(folder) -> Launch:
    return Launch(job_id="job", run=1, address="unix:/w", token="t", work_dir=folder / "run-1")


def test_a_run_gets_nothing_of_the_servers_configuration(tmp_path, monkeypatch):
    for name in ("LAMBENT_DATABASE", "LAMBENT_STORE", "LAMBENT_API_KEY"):
        monkeypatch.setenv(name, "secret")
    executor = LocalExecutor((sys.executable, "-IS", "-c", "import os; print(*os.environ)"))
    handle = executor.start(launch(tmp_path))
    deadline = time.monotonic() + 10.0
    while (gone := executor.poll(handle)) is None:
        assert time.monotonic() < deadline
        time.sleep(0.01)
    assert gone == Gone(0)
    names = (tmp_path / "run-1.log").read_text().split()
    assert [name for name in names if name.startswith("LAMBENT_")] == ["LAMBENT_RUN"]


@pytest.mark.parametrize("same", [True, False])
def test_a_process_is_adopted_by_its_start_and_not_by_its_number(same):
    identity = process_identity(os.getpid())
    handle = {"pid": os.getpid(), "identity": identity if same else f"{identity}0", "gpus": []}
    assert LocalExecutor(()).adopt(handle) is same
