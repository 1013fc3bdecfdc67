"""The contents of LAMBENT_RUN, as a run understands them."""

import json
from dataclasses import fields
from pathlib import Path

from lambent_run.job.connection import Identity
from lambent_server.core.settings import Settings
from lambent_server.executors import Launch, told_in_environment


def test_a_run_is_told_everything_that_it_can_be_told(tmp_path: Path):
    launch = Launch(
        job_id="job_a",
        run=3,
        address="unix:/s",
        token="t",
        work_dir=tmp_path,
        servers=("unix:/s", "tls:there:1"),
        authority="PEM",
        authority_name="lambent",
    )
    settings = Settings(
        data=tmp_path, run_file_bytes=1, run_processes=2, run_give_up_after_s=3.0, stop_grace_s=4.0
    )
    told = {**told_in_environment(launch, settings), "work_dir": "/x", "memory_bytes": 5}
    assert set(told) == {field.name for field in fields(Identity)}
    assert Identity.from_environment({"LAMBENT_RUN": json.dumps(told)}) == Identity(
        job_id="job_a",
        run=3,
        address="unix:/s",
        token="t",
        work_dir=Path("/x"),
        memory_bytes=5,
        file_bytes=1,
        processes=2,
        give_up_after_s=3.0,
        stop_grace_s=4.0,
        servers=("unix:/s", "tls:there:1"),
        authority="PEM",
        authority_name="lambent",
    )
