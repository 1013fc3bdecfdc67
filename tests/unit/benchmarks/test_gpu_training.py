"""Trainings in sittings."""

import json
import time
from pathlib import Path

import pytest
from flashcache.presets import preset
from lambent_run.run.spec import RunSpec

from benchmarks.gpu_training import Sitting, add_seconds, curve, keep_ends, shortened, training

SAMPLE = Path(__file__).parents[2] / "data" / "still_life"


def test_a_shorter_schedule_warms_up_for_the_same_share():
    assert shortened("paper_tensoir", 1.0) == {}
    spec = RunSpec.from_options(
        SAMPLE, preset="paper_tensoir", overrides=shortened("paper_tensoir", 0.1), seed=0
    )
    whole = preset("paper_tensoir")
    assert spec.config.stage_one.num_steps == whole.stage_one.num_steps // 10
    assert spec.config.stage_one.warmup_steps == whole.stage_one.warmup_steps // 10
    assert spec.config.stage_two.num_steps == whole.stage_two.num_steps // 10


def test_a_sitting_ends_at_its_time(tmp_path):
    for ends_at, over in ((time.monotonic() + 100.0, False), (time.monotonic(), True)):
        assert Sitting(tmp_path, tmp_path, {}, ends_at).should_stop() == over


def test_seconds_of_sittings_add_up(tmp_path):
    for seconds in (1.5, 2.0):
        add_seconds(tmp_path / "seconds.json", seconds)
    assert json.loads((tmp_path / "seconds.json").read_text()) == {"seconds": 3.5}


def test_a_curve_knows_its_marks_in_the_order_of_training(tmp_path):
    marks = [{"stage": stage, "step": step} for stage, step in (("joint", 5), ("cache", 90), ("cache", 10))]
    path = tmp_path / "marks.json"
    path.write_text(json.dumps({str(place): mark for place, mark in enumerate(marks)}))
    reporter = Sitting(tmp_path, tmp_path, {}, 0.0)
    found = curve(tmp_path / "run", tmp_path / "kept", path, 1, reporter, 0.0)
    assert [(one["stage"], one["step"]) for one in found] == [("cache", 10), ("cache", 90), ("joint", 5)]


def test_the_end_of_each_stage_is_kept(tmp_path):
    for stage, step in (("cache", 10), ("cache", 20), ("joint", 5)):
        made = tmp_path / "run" / stage / f"step_{step:07d}"
        made.mkdir(parents=True)
        (made / "model.safetensors").write_bytes(b"weights")
        (made / "state.json").write_text("{}")
    keep_ends(tmp_path / "run", tmp_path / "kept")
    assert {path.name for path in (tmp_path / "kept").iterdir()} == {"cache_0000020", "joint_0000005"}


@pytest.mark.slow
def test_a_training_that_ran_out_of_time_goes_on_in_the_next_sitting(tmp_path):
    def sit(seconds: float) -> dict:
        return training(
            SAMPLE,
            tmp_path / "training",
            preset_name="tiny",
            share=0.1,
            environments=None,
            device="cpu",
            views=1,
            points=1,
            seconds=seconds,
        )

    first = sit(0.0)
    assert not first["finished"]
    assert first["figures"] == {}
    last = sit(600.0)
    assert last["finished"]
    assert [(one["stage"], one["step"]) for one in last["marks"]] == [("cache", 35), ("joint", 35)]
    assert last["figures"]["cache novel views [dB]"] > 5.0
