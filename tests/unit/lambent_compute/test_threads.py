"""Results of threads come in order, and nothing is begun after the caller has stopped."""

import time
from contextlib import closing

import pytest
from lambent_compute.threads import in_order


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
