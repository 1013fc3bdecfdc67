"""Conclusions about an estimator from the z-scores of pixels."""

import numpy as np
import pytest
import torch
from flashcache.data.space import domain_of
from flashcache.physical.model import InverseModel
from flashcache.presets import tiny
from support.lit_sphere import lit_sphere

from benchmarks.unbiasedness import Means, compare, verdict

PIXELS, CALLS = 256, 400


def means(level: np.ndarray, seed: int) -> Means:
    noise = np.random.default_rng(seed).normal(size=(CALLS, PIXELS)) * 0.3
    draws = level + noise
    return Means(draws.mean(axis=0), draws.var(axis=0, ddof=1) / CALLS, 0.0)


def levels() -> np.ndarray:
    return np.random.default_rng(9).uniform(0.2, 1.0, PIXELS)


def test_two_means_of_the_same_radiance_give_standard_normal_scores():
    found = verdict(means(levels(), 1), means(levels(), 2))
    assert found.chi_square > 1e-3
    assert found.kolmogorov_smirnov > 1e-3
    assert abs(found.bias) < 4.0 * found.bias_error
    assert np.std(found.z) == pytest.approx(1.0, abs=0.2)


def test_a_bias_of_two_standard_errors_in_every_pixel_is_noticed():
    found = verdict(means(levels() + 0.03, 1), means(levels(), 2))
    assert found.chi_square < 1e-6
    assert found.kolmogorov_smirnov < 1e-6
    assert found.bias == pytest.approx(0.03 / levels().mean(), abs=4.0 * found.bias_error)


def test_biases_that_cancel_over_the_picture_are_noticed_pixel_by_pixel():
    sign = np.where(np.arange(PIXELS) % 2, 1.0, -1.0)
    found = verdict(means(levels() + 0.05 * sign, 1), means(levels(), 2))
    assert abs(found.bias) < 4.0 * found.bias_error
    assert found.chi_square < 1e-6


def test_too_little_scatter_is_as_odd_as_too_much():
    reference = means(levels(), 2)
    same = Means(reference.mean + 1e-9, reference.variance, 0.0)
    assert verdict(same, reference).chi_square < 1e-6


@pytest.mark.slow
def test_the_estimator_of_a_fresh_model_passes_and_the_fast_cache_alone_does_not():
    config, scene = tiny(), lit_sphere()
    torch.manual_seed(0)
    model = InverseModel(config.model, domain_of(scene, config.space, config.model.environment))
    found = compare(model, scene, config.stage_two, pixels=24, estimates=128, samples=1024)
    assert found["control variate"].chi_square > 1e-4
    assert found["fast cache only"].chi_square < 1e-6
