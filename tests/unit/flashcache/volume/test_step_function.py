"""Sampling and blurring of piecewise-constant functions."""

import pytest
import torch
from flashcache.volume.step_function import blurred_masses, edges_from_centres, sample_centres


def random_step(num_rays: int, num_samples: int) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(num_samples)
    lengths = torch.rand(num_rays, num_samples, generator=generator, dtype=torch.float64) + 0.05
    edges = torch.nn.functional.pad(lengths.cumsum(dim=-1), (1, 0))
    weights = torch.rand(num_rays, num_samples, generator=generator, dtype=torch.float64)
    return edges / edges[:, -1:], weights / weights.sum(dim=-1, keepdim=True)


def test_samples_fall_into_intervals_in_proportion_to_their_weights():
    edges, weights = random_step(1, 6)
    u = torch.tensor([[0.37]], dtype=torch.float64)
    centres = sample_centres(edges, weights, 20_000, u)
    counts = torch.histogram(centres[0], edges[0]).hist / 20_000
    expected = (weights[0] + 1e-5) / (weights[0] + 1e-5).sum()
    assert (counts - expected).abs().max() < 2e-4


def test_a_zero_exponent_samples_all_intervals_alike():
    edges, weights = random_step(1, 5)
    centres = sample_centres(edges, weights, 10_000, None, 0.0)
    counts = torch.histogram(centres[0], edges[0]).hist / 10_000
    assert (counts - 0.2).abs().max() < 1e-3


def test_edges_are_increasing_and_inside_the_unit_interval():
    edges, weights = random_step(30, 8)
    found = edges_from_centres(sample_centres(edges, weights, 16, None))
    assert found.shape == (30, 17)
    assert (found[:, 1:] >= found[:, :-1]).all()
    assert found.min() >= 0.0
    assert found.max() <= 1.0


def test_a_blur_keeps_the_total_mass_when_the_queries_reach_far_enough():
    edges, weights = random_step(10, 7)
    queries = torch.linspace(-0.5, 1.5, 40, dtype=torch.float64).expand(10, -1)
    masses = blurred_masses(edges, weights, 0.05, queries)
    assert torch.allclose(masses.sum(dim=-1), weights.sum(dim=-1))


@pytest.mark.parametrize("half_width", [0.003, 0.05])
def test_a_blur_equals_a_numerical_convolution(half_width):
    edges, weights = random_step(1, 4)
    queries = torch.tensor([[0.1, 0.3, 0.55, 0.9]], dtype=torch.float64)
    masses = blurred_masses(edges, weights, half_width, queries)
    grid = torch.linspace(-0.2, 1.2, 400_001, dtype=torch.float64)
    height = weights[0] / edges[0].diff()
    interval = (torch.searchsorted(edges[0].contiguous(), grid, right=True) - 1).clamp(0, 3)
    inside = (grid >= edges[0, 0]) & (grid < edges[0, -1])
    density = torch.where(inside, height[interval], 0.0)
    cdf = torch.nn.functional.pad(density.cumsum(0), (1, 0)) * (grid[1] - grid[0])

    def integral(x: float) -> float:
        return float(cdf[round((min(max(x, -0.2), 1.2) + 0.2) / 1.4 * 400_000)])

    def blurred_cdf(x: float) -> float:
        shifts = torch.linspace(-half_width, half_width, 401, dtype=torch.float64)
        return sum(integral(x + float(shift)) for shift in shifts) / 401

    expected = [
        blurred_cdf(float(b)) - blurred_cdf(float(a))
        for a, b in zip(queries[0, :-1], queries[0, 1:], strict=True)
    ]
    assert torch.allclose(masses[0], torch.tensor(expected, dtype=torch.float64), atol=2e-3)
