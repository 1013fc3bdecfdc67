import torch
from flashcache.losses.photometric import consistency
from support.statistics import assert_mean


def test_the_mean_gradient_is_that_of_the_squared_error_to_the_mean():
    rows = 5000
    generator = torch.Generator().manual_seed(0)
    expected = torch.tensor([0.4, 0.1, 0.8], dtype=torch.float64)
    physical = expected * (0.4 + 1.2 * torch.rand(rows, 3, generator=generator, dtype=torch.float64))
    start = torch.tensor([0.6, 0.3, 0.2], dtype=torch.float64)
    cache = start.expand(rows, 3).clone().requires_grad_()
    (rows * consistency(cache, physical, torch.ones(rows, dtype=torch.float64))).backward()
    assert_mean(cache.grad, 2.0 * (start - expected) / (start + 0.01) / 3.0)


def test_the_physical_estimate_gets_no_gradient_and_uncovered_points_do_not_count():
    cache, physical = torch.rand(3, 3).requires_grad_(), torch.rand(3, 3).requires_grad_()
    consistency(cache, physical, torch.tensor([1.0, 0.0, 1.0])).backward()
    assert physical.grad is None
    assert not cache.grad[1].any()
    assert cache.grad[0].any()
