"""Processes of a benchmark: each stage one once, nothing twice, failures do not spread, and a clean end."""

import os
import signal
import sys
import threading
import time
from pathlib import Path

import pytest
from lambent_core.errors import Stopped
from lambent_run.benchmark import runner
from lambent_run.benchmark.runner import parts_of, run_parts
from support.benchmark_cells import cell

FAKE = Path(__file__).parents[3] / "support" / "fake_cell.py"


@pytest.fixture(autouse=True)
def fake_processes(monkeypatch):
    monkeypatch.setattr(runner, "COMMAND", (sys.executable, str(FAKE)))
    monkeypatch.setattr(runner, "POLL_S", 0.01)


def run(tmp_path, cells, *, jobs=1, devices=("cpu",)):
    """Return the events of a benchmark and the ablations that failed."""
    events = []
    parts = parts_of(cells, tmp_path)
    failed = run_parts(
        parts,
        jobs=jobs,
        devices=devices,
        event=lambda what, part, _: events.append((what, part.kind, part.cell.ablation, part.cell.seed)),
    )
    return events, [(part.kind, part.cell.ablation) for part in failed]


def starts(tmp_path) -> list[list[str]]:
    return [line.split() for line in (tmp_path / "starts.txt").read_text().splitlines()]


def test_all_ablations_of_a_scene_and_seed_share_one_stage_one(tmp_path):
    cells = [cell(ablation=name, seed=seed) for seed in (0, 1) for name in ("full", "k2", "depth")]
    events, failed = run(tmp_path, cells, jobs=3)
    assert failed == []
    kinds = [kind for kind, *_ in starts(tmp_path)]
    assert kinds.count("stage-one") == 2
    assert kinds.count("cell") == 6
    assert [what for what, *_ in events].count("finished") == 8


def test_finished_cells_are_not_computed_again(tmp_path):
    run(tmp_path, [cell(), cell(ablation="k2")])
    before = len(starts(tmp_path))
    events, _ = run(tmp_path, [cell(), cell(ablation="k2"), cell(ablation="depth")])
    assert len(starts(tmp_path)) == before + 1
    assert ("started", "cell", "depth", 0) in events
    assert [what for what, *_ in events].count("reused") == 3


def test_other_inputs_are_another_cell(tmp_path):
    run(tmp_path, [cell()])
    before = len(starts(tmp_path))
    run(tmp_path, [cell(inputs="f" * 64)])
    assert len(starts(tmp_path)) == before + 1


def test_stage_one_is_not_trained_again_when_only_its_folder_is_gone_and_all_cells_are_there(tmp_path):
    import shutil

    run(tmp_path, [cell()])
    shutil.rmtree(tmp_path / "stage_one")
    before = len(starts(tmp_path))
    run(tmp_path, [cell()])
    assert len(starts(tmp_path)) == before


def test_a_failure_leaves_the_other_cells_alone_and_is_tried_again(tmp_path):
    cells = [cell(ablation="broken"), cell()]
    _, failed = run(tmp_path, cells)
    assert failed == [("cell", "broken")]
    assert "broken on purpose" in (tmp_path / "cells" / cells[0].name / "log.txt").read_text()
    _, failed = run(tmp_path, cells)
    assert failed == [("cell", "broken")]
    names = [name for _, name, _ in starts(tmp_path)]
    assert names.count(cells[0].name) == 2
    assert names.count(cells[1].name) == 1


def test_cells_fail_with_their_stage_one(tmp_path, monkeypatch):
    monkeypatch.setattr(runner, "COMMAND", (sys.executable, "-c", "raise SystemExit(3)"))
    _, failed = run(tmp_path, [cell(), cell(ablation="k2")])
    assert sorted(failed) == [("cell", "full"), ("cell", "k2"), ("stage-one", "full")]


def test_jobs_are_spread_over_the_devices(tmp_path):
    cells = [cell(seed=seed) for seed in range(6)]
    run(tmp_path, cells, jobs=2, devices=("cuda:0", "cuda:1"))
    assert {device for _, _, device in starts(tmp_path)} == {"cuda:0", "cuda:1"}


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_request_to_stop_lets_processes_write_their_checkpoints(tmp_path, number):
    slow = cell(ablation="slow")
    folder = tmp_path / "cells" / slow.name

    def interrupt():
        while not (folder / "waiting").exists():
            time.sleep(0.01)
        os.kill(os.getpid(), number)

    thread = threading.Thread(target=interrupt, daemon=True)
    thread.start()
    with pytest.raises(Stopped):
        run(tmp_path, [slow])
    thread.join()
    assert (folder / "asked_to_end").exists()
