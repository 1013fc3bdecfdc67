"""A run that is trained by two ranks: killed ranks cost nothing but time, and either number continues."""

import os
import random
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import psutil
import pytest
from flashcache.training.checkpoint import latest_checkpoint
from lambent_core.errors import Stopped
from lambent_run.run.pipeline import run_pipeline
from lambent_run.run.spec import RunSpec
from safetensors.torch import load_file
from support.captures import REFERENCES
from support.recording_reporter import RecordingReporter

pytestmark = [pytest.mark.slow, pytest.mark.timeout(400)]
KILLS = int(os.environ.get("LAMBENT_CHAOS_RANK_KILLS", "1"))
SCENE = REFERENCES / "scenes" / "tensoir_synthetic"
SMALL = {
    "max_side": "16",
    "checkpoint_steps": "4",
    "checkpoint_interval_s": "1e9",
    "stage_one.num_rays": "64",
    "stage_one.num_steps": "16",
    "stage_two.num_rays": "32",
    "stage_two.num_steps": "4",
    "stage_two.warmup_steps": "2",
    "stage_two.distil.num_steps": "2",
    "stage_two.distil.num_points": "32",
}


def train(folder: Path, reporter: RecordingReporter, num_ranks: int = 2, tasks=("ingest", "cache")) -> Path:
    """Train a run, or continue with it, and return the checkpoint at the end of its last task."""
    spec = RunSpec.from_options(SCENE, preset="tiny", overrides=SMALL)
    run_pipeline(spec, folder, "cpu", reporter, tasks, num_ranks=num_ranks)
    found = latest_checkpoint(folder / tasks[-1])
    assert found is not None
    return found


def running_ranks() -> list[psutil.Process]:
    """Return the ranks that this process has started, in their order."""
    return [p for p in psutil.Process().children() if "lambent_run.run.rank" in " ".join(p.cmdline())]


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    """Return the end of stage one of a run that nothing disturbed."""
    reporter = RecordingReporter()
    found = train(tmp_path_factory.mktemp("whole") / "run", reporter)
    assert not reporter.named("ranks.lost")
    assert [fields["step"] for fields in reporter.named("checkpoint")] == [4, 8, 12, 16]
    progress = [fields for fields in reporter.named("progress") if fields["stage"] == "cache"]
    assert progress[-1]["step"] == 16
    assert progress[-1]["fraction"] == 1.0
    return found


def same(one: Path, other: Path) -> bool:
    names = ("model.safetensors", "optimiser.safetensors")
    return all((one / name).read_bytes() == (other / name).read_bytes() for name in names)


class Killing(RecordingReporter):
    """Kills a rank some time after the checkpoints of these steps."""

    def __init__(self, choice: random.Random, steps: set[int]) -> None:
        super().__init__()
        self._choice, self._steps = choice, steps

    def checkpoint(self, stage: str, step: int, folder: Path) -> None:
        super().checkpoint(stage, step, folder)
        if step in self._steps:
            self._steps.remove(step)
            victim = self._choice.choice(running_ranks())
            threading.Timer(self._choice.uniform(0.0, 0.1), victim.kill).start()


@pytest.mark.parametrize("seed", range(KILLS))
def test_a_run_whose_ranks_are_killed_ends_with_the_weights_of_one_that_was_left_alone(tmp_path, whole, seed):
    reporter = Killing(random.Random(seed), {4, 8})  # noqa: S311
    found = train(tmp_path / "run", reporter)
    assert 1 <= len(reporter.named("ranks.lost")) <= 2
    assert same(found, whole)
    assert not running_ranks()


class StoppingAfter(RecordingReporter):
    """Asks to end after the first checkpoint."""

    def should_stop(self) -> bool:
        return bool(self.named("checkpoint"))


def test_a_stopped_run_leaves_one_checkpoint_from_which_either_number_of_processes_goes_on(tmp_path, whole):
    run, stopping = tmp_path / "run", StoppingAfter()
    with pytest.raises(Stopped):
        train(run, stopping)
    step = stopping.named("checkpoint")[-1]["step"]
    assert 4 <= step < 16
    assert len(stopping.named("checkpoint")) <= 2
    copy = tmp_path / "copy"
    subprocess.run(["cp", "-r", str(run), str(copy)], check=True)
    by_two, by_one = RecordingReporter(), RecordingReporter()
    assert same(train(run, by_two), whole)
    alone = train(copy, by_one, num_ranks=1)
    for reporter in (by_two, by_one):
        assert [fields["step"] for fields in reporter.named("checkpoint.resumed")] == [step]
    assert load_file(alone / "model.safetensors").keys() == load_file(whole / "model.safetensors").keys()


@pytest.mark.long
def test_both_stages_are_trained_by_ranks(tmp_path):
    reporter = RecordingReporter()
    train(tmp_path / "run", reporter, tasks=("ingest", "cache", "joint"))
    assert [fields["step"] for fields in reporter.named("checkpoint")] == [4, 8, 12, 16, 4, 6]
    assert not running_ranks()


@pytest.mark.long
@pytest.mark.timeout(400)
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="elsewhere they end with the socket alone")
def test_ranks_end_with_a_run_that_is_killed_in_the_middle_of_a_step(tmp_path):
    program = (
        "import sys; sys.path.insert(0, sys.argv[2]); from pathlib import Path; "
        "from support.recording_reporter import RecordingReporter; "
        "from lambent_run.run.pipeline import run_pipeline; from lambent_run.run.spec import RunSpec; "
        "run_pipeline(RunSpec.from_options(Path(sys.argv[3]), preset='tiny', "
        "overrides={'max_side': '16', 'checkpoint_steps': '2'}), "
        "Path(sys.argv[1]), 'cpu', RecordingReporter(), ('ingest', 'cache'), num_ranks=2)"
    )
    command = [
        sys.executable,
        "-c",
        program,
        str(tmp_path / "run"),
        str(Path(__file__).parents[1]),
        str(SCENE),
    ]
    with subprocess.Popen(command) as run:
        deadline = time.monotonic() + 300.0
        while latest_checkpoint(tmp_path / "run" / "cache") is None:
            assert time.monotonic() < deadline
            time.sleep(0.05)
        ranks = psutil.Process(run.pid).children()
        run.send_signal(signal.SIGKILL)
    assert len(ranks) == 2
    _, alive = psutil.wait_procs(ranks, timeout=10.0)
    assert not alive
