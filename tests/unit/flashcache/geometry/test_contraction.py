"""Contraction of space and its derivative."""

import torch
from flashcache.geometry.contraction import contract, contract_vjp


def test_points_inside_the_radius_are_only_scaled():
    points = torch.tensor([[0.3, -0.4, 0.5], [0.0, 0.0, 1.9]], dtype=torch.float64)
    assert torch.equal(contract(points, 2.0), points / 2.0)


def test_infinity_lies_at_twice_the_radius():
    far = torch.tensor([[1e9, 0.0, 0.0], [0.0, -1e9, 1e9]], dtype=torch.float64)
    assert torch.allclose(contract(far, 2.0).norm(dim=-1), torch.full((2,), 2.0, dtype=torch.float64))


def test_the_map_is_continuous_where_contraction_begins():
    unit = torch.nn.functional.normalize(torch.randn(50, 3, dtype=torch.float64), dim=-1)
    inside, outside = contract(unit * 1.5 * (1 - 1e-9), 1.5), contract(unit * 1.5 * (1 + 1e-9), 1.5)
    assert (inside - outside).abs().max() < 1e-8


def test_the_written_derivative_equals_that_of_autograd():
    generator = torch.Generator().manual_seed(3)
    points = 4.0 * torch.randn(200, 3, dtype=torch.float64, generator=generator)
    upstream = torch.randn(200, 3, dtype=torch.float64, generator=generator)
    points.requires_grad_()
    (expected,) = torch.autograd.grad((contract(points, 1.7) * upstream).sum(), points)
    assert torch.allclose(contract_vjp(points.detach(), 1.7, upstream), expected, atol=1e-12)
