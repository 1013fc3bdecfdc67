"""A run process that is asked to end by several signals at once."""

import os
import signal
import subprocess
import sys
import time

# What `process.work` does on SIGTERM, without a server.
PROGRAM = """
import os, signal, time
from pathlib import Path
from types import SimpleNamespace
from lambent_run.job.connection import Connection, Identity
from lambent_run.job.server_reporter import ServerReporter
identity = Identity(job_id="j", run=1, address="unix:/nowhere", token="t", work_dir=Path("."))
connection = Connection(identity)
reporter = ServerReporter(connection, Path("."), progress_interval_s=1000.0)
from lambent_run.job.process import stop_on_signals
stop_on_signals(connection, reporter)
print("ready", flush=True)
ends = time.monotonic() + 1.5
while time.monotonic() < ends:
    pass
print("ended", reporter.should_stop(), connection.ending, flush=True)
os._exit(0)
"""


def test_signals_that_interrupt_the_handler_of_another_do_not_stop_a_run_for_ever():
    """The group gets SIGTERM and the supervisor passes it on: the pipeline has it twice, close together."""
    child = subprocess.Popen([sys.executable, "-c", PROGRAM], stdout=subprocess.PIPE, text=True)
    assert child.stdout is not None
    assert child.stdout.readline() == "ready\n"
    ends = time.monotonic() + 1.0
    while time.monotonic() < ends and child.poll() is None:
        os.kill(child.pid, signal.SIGTERM)
    try:
        output, _ = child.communicate(timeout=30)
    finally:
        child.kill()
    assert output == "ended True True\n"
    assert child.returncode == 0
