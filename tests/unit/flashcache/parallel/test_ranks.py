"""Ranks together compute what one process does: gradients, losses, and the same bits on each."""

import pytest
import torch
from support.divided_stages import (
    STEPS,
    agreed,
    assert_close,
    gradients,
    held_the_same,
    rows,
    stepped_with_nan,
    too_many,
    trained,
)
from support.two_ranks import two_ranks

# Starts a second process with torch, and compares on models of all losses.
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def both():
    with two_ranks() as made:
        yield made.both


@pytest.mark.parametrize("cells", [0, 16])
@pytest.mark.parametrize("case", STEPS)
def test_two_ranks_have_the_gradient_of_one_process(both, case, cells):
    kind, step = STEPS[case]
    expected, terms = gradients(None, kind, step, {"cells": cells})
    assert sum(bool(gradient.any()) for gradient in expected.values()) > 5
    for found, found_terms in both(gradients, kind, step, {"cells": cells}):
        assert found_terms == pytest.approx(terms, rel=1e-5, abs=1e-8)
        assert_close(found, expected, 2e-5)


@pytest.mark.parametrize(
    "settings",
    [
        {"secondary_jitter": True},
        {"symmetric": True, "points_per_ray": 2},
        {"warmup_steps": 4},
        {"estimator": "stratified"},
    ],
    ids=str,
)
def test_settings_that_draw_other_numbers_are_divided_too(both, settings):
    expected, terms = gradients(None, "two", 1, settings)
    for found, found_terms in both(gradients, "two", 1, settings):
        assert found_terms == pytest.approx(terms, rel=1e-5, abs=1e-8)
        assert_close(found, expected, 2e-5)


@pytest.mark.parametrize(("kind", "steps"), [("one", 8), ("two", 9)])
def test_after_some_steps_ranks_have_the_same_bits_and_about_those_of_one_process(both, kind, steps):
    expected, records = trained(None, kind, steps, {"cells": 16})
    (first, first_records), (second, second_records) = both(trained, kind, steps, {"cells": 16})
    assert all(torch.equal(first[name], second[name]) for name in expected)
    assert first_records == second_records
    # Adam divides by the gradient's size: a small one with another rounding is another step.
    assert_close(first, expected, 2e-2)
    for found, record in zip(first_records, records, strict=True):
        assert found == pytest.approx(record, rel=1e-2, abs=1e-3)


@pytest.mark.parametrize("kind", ["one", "two"])
def test_a_step_that_is_no_number_on_one_rank_is_skipped_on_all(both, kind):
    assert both(stepped_with_nan, kind) == [(1, False), (1, False)]


@pytest.mark.parametrize("spoil", [None, 0, 1])
def test_one_changed_bit_on_one_rank_is_noticed_by_both(both, spoil):
    assert both(held_the_same, "one", spoil) == [spoil is None] * 2


def test_ranks_agree_on_what_the_first_one_says(both):
    assert both(agreed) == [(1, 0), (1, 0)]


def test_each_rank_has_every_second_ray_of_the_same_batch_and_none_is_left(both):
    assert both(rows, 9) == [[0, 2, 4, 6], [1, 3, 5, 7]]


def test_a_batch_smaller_than_the_number_of_ranks_is_refused(both):
    assert all("1 rays cannot be divided among 2 ranks" in found for found in both(too_many))
