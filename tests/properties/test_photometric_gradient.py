"""Two independent estimates give the gradient of the squared error of the mean; one used twice does not."""

import pytest
import torch
from flashcache.losses.photometric import physical_photometric
from support.statements import assert_two_passes_minimise_the_error_of_the_mean
from support.statistics import assert_mean

ROWS = 20000


def _gradients(independent: bool) -> torch.Tensor:
    """Return one gradient per row, for a picture that is its parameter times noise of mean one."""
    generator = torch.Generator().manual_seed(4)
    noise = torch.rand(2, ROWS, 3, generator=generator, dtype=torch.float64) * 2.0
    parameter = torch.full((ROWS, 1), 0.7, dtype=torch.float64, requires_grad=True)
    first, second = parameter * noise[0], parameter * noise[1 if independent else 0]
    photograph = torch.full((ROWS, 3), 0.9, dtype=torch.float64)
    cache = torch.full((ROWS, 3), 0.5, dtype=torch.float64)
    weight = torch.ones(ROWS, dtype=torch.float64)
    (ROWS * physical_photometric(photograph, first, second, cache, weight)).backward()
    return parameter.grad[:, 0]


# The derivative of (0.9 - p)^2 / (max(0.5, 0.9) + 0.01) at p = 0.7.
EXACT = -2.0 * (0.9 - 0.7) / 0.91


def test_independent_estimates_give_the_gradient_of_the_error_of_the_mean():
    assert_mean(_gradients(independent=True), EXACT)


def test_the_same_estimate_twice_adds_the_gradient_of_its_variance():
    gradients = _gradients(independent=False)
    with pytest.raises(AssertionError, match="standard errors"):
        assert_mean(gradients, EXACT)
    # The variance of p * noise is p^2 / 3.
    assert_mean(gradients, EXACT + 2.0 * 0.7 / 3.0 / 0.91)


def test_two_passes_of_the_estimator_minimise_the_error_of_the_mean_picture():
    assert_two_passes_minimise_the_error_of_the_mean(ROWS)
