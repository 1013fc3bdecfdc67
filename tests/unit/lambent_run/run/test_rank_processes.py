"""The processes of ranks: what they report arrives, what they raise is raised, and none outlives the run."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import psutil
import pytest
from flashcache.errors import ProcessEndedError, TrainingError
from lambent_core.errors import Stopped, UsageError, WorkerError
from lambent_run.run import rank_processes
from lambent_run.run.context import TaskContext
from lambent_run.run.rank_processes import train_by_ranks
from lambent_run.run.spec import RunSpec
from support.recording_reporter import RecordingReporter

pytestmark = pytest.mark.slow
CONFIG = SimpleNamespace(stage_one=SimpleNamespace(num_rays=33))


@pytest.fixture(autouse=True)
def fake(monkeypatch):
    """Start ranks of `support.fake_rank`."""
    monkeypatch.setattr(rank_processes, "PROGRAM", "support.fake_rank")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(path for path in sys.path if path))


def context(folder: Path, first: list[str], second: list[str], reporter=None) -> TaskContext:
    (folder / "acts.json").write_text(json.dumps({"0": first, "1": second}))
    spec = RunSpec(scene=folder, config=CONFIG)
    reporter = reporter or RecordingReporter()
    return TaskContext(spec=spec, run_dir=folder, device="cpu", reporter=reporter, task="cache", num_ranks=2)


def pids(folder: Path) -> list[int]:
    return [int(path.name.rpartition("-")[2]) for path in folder.glob("rank*")]


def alive(pid: int) -> bool:
    try:
        return psutil.Process(pid).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


def until(true, limit_s: float = 60.0) -> None:
    deadline = time.monotonic() + limit_s
    while not true():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def test_what_the_first_one_reports_arrives_in_order_and_the_others_are_silent(tmp_path):
    made = context(tmp_path, ["report checkpoint report"], ["report checkpoint"])
    train_by_ranks(made)
    calls = [(name, fields.get("rank", fields.get("step"))) for name, fields in made.reporter.calls]
    assert calls == [
        ("ranks.batch_rounded", None),
        ("told", 0),
        ("progress", 1),
        ("checkpoint", 5),
        ("told", 0),
        ("progress", 1),
    ]
    assert made.reporter.named("ranks.batch_rounded") == [{"batch": "stage_one", "rays": 33, "divided": 32}]


@pytest.mark.parametrize("number", [0, 1])
def test_all_start_again_where_one_is_killed(tmp_path, number):
    acts = [["report", "report"], ["hang", "report"]]
    acts[number][0] = "meet die"
    acts[1 - number][0] = "hang"
    made = context(tmp_path, *acts)
    train_by_ranks(made)
    (lost,) = made.reporter.named("ranks.lost")
    assert lost == {"stage": "cache", "lost": 1, "reason": f"rank {number} ended with signal 9"}
    assert len(made.reporter.named("progress")) == 1
    assert len(pids(tmp_path)) == 4
    assert not any(alive(pid) for pid in pids(tmp_path))


def test_the_error_of_the_work_is_raised_and_not_that_the_others_miss_a_rank(tmp_path):
    with pytest.raises(TrainingError, match="not a number"):
        train_by_ranks(context(tmp_path, ["meet lost"], ["meet diverge"]))
    assert len(pids(tmp_path)) == 2


def test_errors_for_people_keep_their_codes(tmp_path):
    with pytest.raises(UsageError) as raised:
        train_by_ranks(context(tmp_path, ["hang"], ["meet misuse"]))
    assert (raised.value.code, raised.value.message) == ("test.misused", "in words")


def test_ranks_that_are_killed_again_and_again_end_the_run_as_a_lack_of_memory_does(tmp_path):
    with pytest.raises(ProcessEndedError, match="3 times") as raised:
        train_by_ranks(context(tmp_path, ["hang"], ["meet die"]))
    assert raised.value.was_killed
    assert len(pids(tmp_path)) == 6


def test_losses_between_checkpoints_have_a_limit_of_their_own(tmp_path, monkeypatch):
    monkeypatch.setattr(rank_processes, "MOST_LOSSES_IN_A_ROW", 2)
    monkeypatch.setattr(rank_processes, "MOST_LOSSES", 3)
    made = context(tmp_path, ["checkpoint exit"], ["hang"])
    with pytest.raises(ProcessEndedError, match="exit code 3") as raised:
        train_by_ranks(made)
    assert not raised.value.was_killed
    assert [fields["lost"] for fields in made.reporter.named("ranks.lost")] == [1, 2, 3]


def test_ranks_that_miss_each_other_again_and_again_are_an_error_of_its_own(tmp_path, monkeypatch):
    monkeypatch.setattr(rank_processes, "MOST_LOSSES_IN_A_ROW", 1)
    with pytest.raises(WorkerError, match="the other one is gone") as raised:
        train_by_ranks(context(tmp_path, ["lost"], ["lost"]))
    assert raised.value.code == "ranks.lost"


class Stopping(RecordingReporter):
    """Asks to end as soon as something was reported."""

    def should_stop(self) -> bool:
        return bool(self.named("told") or self.named("ranks.lost"))


def test_a_run_that_is_asked_to_end_tells_the_first_one_and_waits_for_all(tmp_path):
    made = context(tmp_path, ["signals report wait"], ["signals"], Stopping())
    with pytest.raises(Stopped):
        train_by_ranks(made)
    assert not any(alive(pid) for pid in pids(tmp_path))


def test_a_loss_while_the_run_is_asked_to_end_ends_it(tmp_path):
    made = context(tmp_path, ["report hang"], ["meet die"], Stopping())
    made.reporter.log("told")
    with pytest.raises(Stopped):
        train_by_ranks(made)
    assert len(pids(tmp_path)) == 2


class Broken(RecordingReporter):
    """Cannot keep checkpoints."""

    def checkpoint(self, stage: str, step: int, folder: Path) -> None:
        raise OSError("fenced off")


def test_ranks_end_with_a_reporter_that_fails(tmp_path):
    with pytest.raises(OSError, match="fenced off"):
        train_by_ranks(context(tmp_path, ["checkpoint"], ["hang"], Broken()))
    assert not any(alive(pid) for pid in pids(tmp_path))


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="elsewhere they end with the socket alone")
def test_no_rank_outlives_a_run_that_is_killed(tmp_path):
    context(tmp_path, ["hang"], ["hang"])
    program = (
        "from pathlib import Path; from types import SimpleNamespace; import sys; "
        "from lambent_run.run import rank_processes; rank_processes.PROGRAM = 'support.fake_rank'; "
        "from lambent_run.run.context import TaskContext; from lambent_run.run.spec import RunSpec; "
        "from support.recording_reporter import RecordingReporter; folder = Path(sys.argv[1]); "
        "config = SimpleNamespace(stage_one=SimpleNamespace(num_rays=2)); "
        "rank_processes.train_by_ranks(TaskContext(spec=RunSpec(scene=folder, config=config), "
        "run_dir=folder, device='cpu', reporter=RecordingReporter(), task='cache', num_ranks=2))"
    )
    with subprocess.Popen([sys.executable, "-c", program, str(tmp_path)]) as run:
        until(lambda: len(pids(tmp_path)) == 2)
        run.send_signal(signal.SIGKILL)
    until(lambda: not any(alive(pid) for pid in pids(tmp_path)))
