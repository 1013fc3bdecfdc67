"""Batches, schedules and memory of the paper's steps."""

import pytest
import torch
from flashcache.presets import preset
from paper_step import measure, read_scene, shortened, whole_batch_bytes, with_share


def test_a_share_divides_the_rays_of_both_stages():
    config = with_share(preset("paper_tensoir"), 64)
    assert (config.stage_one.num_rays, config.stage_two.num_rays) == (256, 16)


def test_a_shortened_schedule_warms_up_for_the_same_share_of_its_steps():
    whole = preset("paper_tensoir")
    short = shortened(whole, 500)
    assert short.stage_one.num_steps == short.stage_two.num_steps == 500
    shares = [one.stage_one.warmup_steps / one.stage_one.num_steps for one in (whole, short)]
    assert shares[0] == pytest.approx(shares[1])
    assert shares[0] > 0.0


def test_memory_of_the_whole_batch_lies_on_the_line_through_two_parts():
    small, large = {"rays": 256, "peak": 1000.0}, {"rays": 1024, "peak": 1768.0}
    assert whole_batch_bytes(small, large, 256) == pytest.approx(1000.0)
    assert whole_batch_bytes(small, large, 16384) == pytest.approx(1000.0 + 16128.0)


@pytest.mark.slow
@pytest.mark.parametrize("stage", ["one", "two"])
def test_a_measurement_takes_the_steps_and_counts_what_trains(stage: str):
    config = with_share(preset("tiny"), 16)
    found = measure(stage, read_scene(None, config), config, torch.device("cpu"), 2)
    assert len(found["seconds"]) == len(found["losses"]) == 2
    assert 0 < found["trained"] < found["parameters"]
    assert found["peak"] >= found["before"] > 0
