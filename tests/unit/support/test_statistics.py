"""The statistical assertion itself: it accepts what is true and rejects what is not."""

import numpy as np
import pytest
from support.statistics import assert_mean


def _samples(count: int = 4000, elements: int = 50) -> np.ndarray:
    return np.random.default_rng(3).normal(2.0, 1.0, size=(count, elements))


def test_a_true_mean_is_accepted_for_every_element():
    assert_mean(_samples(), 2.0)


def test_a_mean_that_is_off_by_eight_standard_errors_in_one_element_is_rejected():
    samples = _samples()
    samples[:, 17] += 8.0 / np.sqrt(len(samples))
    with pytest.raises(AssertionError, match="element"):
        assert_mean(samples, 2.0)


def test_the_error_of_the_expected_value_is_allowed_for():
    samples = _samples()
    with pytest.raises(AssertionError):
        assert_mean(samples, 2.2)
    assert_mean(samples, 2.2, expected_error=0.2)


def test_constant_samples_must_equal_the_expected_value():
    samples = np.full((100, 3), 0.1)
    assert_mean(samples, 0.1)
    with pytest.raises(AssertionError):
        assert_mean(samples, 0.1001)


def test_the_false_alarm_rate_is_what_was_asked_for():
    rng = np.random.default_rng(11)
    alarms = 0
    for _ in range(400):
        try:
            assert_mean(rng.normal(size=(200, 5)), 0.0, false_alarm=0.05)
        except AssertionError:
            alarms += 1
    # 400 trials at 5 %: mean 20, standard deviation 4.4.
    assert 3 <= alarms <= 40


def test_samples_that_are_not_finite_are_rejected():
    samples = _samples()
    samples[3, 3] = np.nan
    with pytest.raises(AssertionError, match="finite"):
        assert_mean(samples, 2.0)
