"""Ctrl-C, which a terminal sends to every process of a command, whenever it comes."""

import os
import signal
import subprocess
import sys

import pytest
from support.captures import write_tensoir

pytestmark = [pytest.mark.slow, pytest.mark.long, pytest.mark.timeout(180)]


def started(folder, *options):
    """Return a training in a group of its own, as a terminal starts it."""
    environment = {name: value for name, value in os.environ.items() if name != "OMP_NUM_THREADS"}
    command = [sys.executable, "-m", "lambent", "train", folder / "scene", "-o", folder / "run"]
    return subprocess.Popen(
        [*map(str, command), "--preset", "tiny", *options],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
        start_new_session=True,
    )


@pytest.mark.parametrize("options", [("--threads", "2"), ("--threads", "2", "--ranks", "2")], ids=" ".join)
@pytest.mark.parametrize("moment", ["reading the photographs", "training the radiance cache"])
def test_a_training_by_several_processes_stops_after_its_step(tmp_path, options, moment):
    """Its helpers are only loading their libraries when the line of their task is shown."""
    write_tensoir(tmp_path / "scene")
    lines = []
    with started(tmp_path, *options) as training:
        for line in training.stderr:
            lines.append(line)
            if line.startswith(moment):
                os.killpg(training.pid, signal.SIGINT)
                break
        lines += training.stderr.readlines()
    said = "".join(lines)
    assert training.returncode == 130, said
    assert "Traceback" not in said
    assert "stopping after this step; once more to stop at once\n" in said
    assert lines[-1].startswith("stopped")
