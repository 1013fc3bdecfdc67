"""Medians, ranges and bandwidths."""

import torch

from benchmarks.gpu_timing import bandwidth, machine, spread, timed

CPU = torch.device("cpu")


def test_a_spread_is_median_and_range():
    assert spread([3.0, 1.0, 10.0]) == {"median": 3.0, "least": 1.0, "largest": 10.0, "repeats": 3}


def test_warm_ups_are_made_and_not_timed():
    calls = []
    found = timed(lambda: calls.append(1), CPU, 4, warm_up=2)
    assert len(calls) == 6
    assert found["repeats"] == 4
    assert 0.0 <= found["least"] <= found["median"] <= found["largest"]


def test_a_copy_reads_and_writes():
    assert bandwidth(CPU, 2**20) > 1e6


def test_the_machine_says_what_is_measured():
    found = machine(CPU)
    assert found["torch"] == torch.__version__
    assert "gpu" not in found
