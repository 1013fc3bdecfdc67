"""The number of threads; results come in order, and nothing is begun after the caller has stopped."""

import os
import time
from contextlib import closing
from pathlib import Path

import pytest
from lambent_compute.threads import available_threads, in_order

CORES = len(os.sched_getaffinity(0))


@pytest.mark.parametrize("num_threads", [1, 3])
def test_results_come_in_the_order_of_the_items(num_threads):
    def work(item):
        time.sleep(0.005 * (item % 3))
        return item

    assert list(in_order(work, range(20), num_threads)) == list(range(20))
    assert list(in_order(work, [], num_threads)) == []


@pytest.mark.parametrize("num_threads", [1, 2])
def test_a_caller_that_stops_leaves_the_rest_undone(num_threads):
    begun = []

    def work(item):
        begun.append(item)
        time.sleep(0.01)
        return item

    with closing(in_order(work, range(100), num_threads)) as results:
        assert next(results) == 0
    assert len(begun) < 10
    time.sleep(0.03)
    assert len(begun) < 10


def test_what_a_thread_raises_is_raised_here():
    with pytest.raises(ZeroDivisionError):
        list(in_order(lambda item: 1 // item, [1, 0, 1], 2))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("100000 100000", 1),
        ("50000 100000", 1),
        ("900000000 100000", CORES),
        ("max 100000", CORES),
        ("", CORES),
    ],
)
def test_the_quota_of_a_container_counts(tmp_path: Path, text, expected):
    (tmp_path / "cpu.max").write_text(text)
    assert available_threads(tmp_path / "cpu.max") == expected


def test_without_a_quota_all_cores_of_the_affinity_count(tmp_path: Path):
    assert available_threads(tmp_path / "missing") == CORES
