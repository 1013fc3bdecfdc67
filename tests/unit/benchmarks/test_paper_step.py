"""Batches, schedules and memory of the paper's steps."""

import pytest
import torch
from flashcache.memory import MemoryEstimate
from flashcache.presets import preset

from benchmarks.paper_step import describe_estimate, measure, read_scene, shortened, with_share


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


def test_an_estimate_is_described_by_stage_and_in_gibibytes():
    found = MemoryEstimate(
        stage="joint",
        num_parameters=2_000_000,
        parameters=2**30,
        gradients=2**29,
        moments=2**30,
        activations=2**31,
    )
    line = describe_estimate(found)
    assert line.strip().startswith("stage two: 4.50 GiB (parameters 1.00, gradients 0.50, moments 1.00")
    assert "2.0 M parameters" in line


@pytest.mark.slow
@pytest.mark.parametrize("stage", ["one", "two"])
def test_a_measurement_takes_the_steps_and_counts_what_trains(stage: str):
    config = with_share(preset("tiny"), 16)
    found = measure(stage, read_scene(None, config), config, torch.device("cpu"), 2)
    assert len(found["seconds"]) == len(found["losses"]) == 2
    assert 0 < found["trained"] < found["parameters"]
    assert found["peak"] >= found["before"] > 0
