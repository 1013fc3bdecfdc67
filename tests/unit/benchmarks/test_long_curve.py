"""Checkpoints that are kept for a curve, and the table of it."""

import json
from pathlib import Path

import pytest

from benchmarks.long_curve import (
    Keeper,
    kept_checkpoints,
    note_seconds,
    plot,
    read_table,
    seconds_until,
    with_row,
    write_table,
)
from benchmarks.reference_scores import FIGURES


def checkpoint(folder: Path, step: int, seconds: float) -> Path:
    made = folder / f"step_{step:07d}"
    made.mkdir(parents=True)
    (made / "model.safetensors").write_bytes(b"weights")
    (made / "optimiser.safetensors").write_bytes(b"moments")
    (made / "state.json").write_text(json.dumps({"step": step, "seconds": seconds}))
    return made


def row(stage: str, step: int, seconds: float) -> dict[str, object]:
    figures = {"normals, inside mask [deg]": 17.5}
    return {"stage": stage, "step": step, "stage seconds": seconds, "seconds": seconds, **figures}


def test_checkpoints_are_kept_when_the_last_one_kept_is_far_enough_behind(tmp_path: Path):
    keeper = Keeper(tmp_path / "run", tmp_path / "kept", {"cache": 100, "joint": 50})
    for stage, step in (("cache", 60), ("cache", 120), ("cache", 200), ("cache", 230), ("joint", 50)):
        keeper.checkpoint(stage, step, checkpoint(tmp_path / "run" / stage, step, step / 10.0))
    kept = kept_checkpoints(tmp_path / "kept")
    assert [one.name for one in kept] == ["cache_0000120", "cache_0000230", "joint_0000050"]
    assert [one.seconds for one in kept] == [12.0, 23.0, 5.0]


def test_only_the_model_of_a_checkpoint_is_kept(tmp_path: Path):
    keeper = Keeper(tmp_path / "run", tmp_path / "kept", {"cache": 1, "joint": 1})
    keeper.checkpoint("cache", 5, checkpoint(tmp_path / "run" / "cache", 5, 1.0))
    (kept,) = kept_checkpoints(tmp_path / "kept")
    assert sorted(path.name for path in kept.folder.iterdir()) == ["model.safetensors", "state.json"]


def test_a_keeper_that_starts_again_counts_from_what_is_there(tmp_path: Path):
    every = {"cache": 100, "joint": 100}
    first = Keeper(tmp_path / "run", tmp_path / "kept", every)
    first.checkpoint("cache", 100, checkpoint(tmp_path / "run" / "cache", 100, 1.0))
    second = Keeper(tmp_path / "run", tmp_path / "kept", every)
    second.checkpoint("cache", 150, checkpoint(tmp_path / "run" / "cache", 150, 2.0))
    assert [one.step for one in kept_checkpoints(tmp_path / "kept")] == [100]


def test_rows_come_back_from_the_table_in_the_order_of_training(tmp_path: Path):
    rows: list[dict[str, str]] = []
    for one in (row("joint", 50, 8.0), row("cache", 200, 4.0), row("cache", 90, 2.0)):
        rows = with_row(rows, one)
    write_table(tmp_path / "curve.csv", rows)
    found = read_table(tmp_path / "curve.csv")
    assert [(one["stage"], one["step"]) for one in found] == [
        ("cache", "90"),
        ("cache", "200"),
        ("joint", "50"),
    ]
    assert {float(one["normals, inside mask [deg]"]) for one in found} == {17.5}
    assert {one["relit [dB]"] for one in found} == {""}


def test_time_counts_the_stages_before_and_the_polish_its_own(tmp_path: Path):
    every = {"cache": 100, "joint": 50, "polish": 1}
    keeper = Keeper(tmp_path / "run", tmp_path / "kept", every)
    for stage, step in (("cache", 100), ("cache", 200), ("joint", 50), ("joint", 100), ("polish", 1)):
        keeper.checkpoint(stage, step, checkpoint(tmp_path / "run" / stage, step, step / 10.0))
    note_seconds(tmp_path / "kept", 40.0)
    kept = kept_checkpoints(tmp_path / "kept")
    assert [seconds_until(one, kept) for one in kept] == [10.0, 20.0, 25.0, 30.0, 70.0]


def test_there_are_no_rows_before_the_first(tmp_path: Path):
    assert read_table(tmp_path / "curve.csv") == []


@pytest.mark.slow
def test_a_curve_with_gaps_is_drawn(tmp_path: Path):
    rows = with_row(with_row([], row("cache", 90, 2.0)), row("joint", 50, 8.0))
    plot(rows, tmp_path / "curve.png", "title")
    assert (tmp_path / "curve.png").read_bytes().startswith(b"\x89PNG")
    assert len(FIGURES) == 10
