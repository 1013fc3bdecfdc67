"""The plain torch encoder, against the formula written out and against automatic differentiation."""

import itertools
import math

import pytest
import torch
from flashcache.kernels import reference
from flashcache.kernels.layout import GridLayout, build_layout

LAYOUT = build_layout((3, 20), num_features=2, log2_table_size=12, half_extent=1.5)


def table_of(layout: GridLayout, seed: int = 0) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(layout.num_rows, layout.num_features, dtype=torch.float64, generator=generator)


def points_in(extent: float, count: int, seed: int = 1) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return (torch.rand(count, 3, dtype=torch.float64, generator=generator) * 2.0 - 1.0) * extent


def looked_up(z: list[float], table: torch.Tensor, layout: GridLayout) -> list[float]:
    """Return the features of one point by the formula of `layout`, one voxel at a time."""
    features = []
    for level in layout.levels:
        n = level.resolution
        u = [min(max(c * n / (2 * layout.half_extent) + (n - 1) / 2, 0.0), n - 1.0) for c in z]
        cell = [min(math.floor(v), n - 2) for v in u]
        values = torch.zeros(layout.num_features, dtype=table.dtype)
        for corner in itertools.product((0, 1), repeat=3):
            x, y, w = (c + k for c, k in zip(cell, corner, strict=True))
            row = (x + level.multiplier_y * y + level.multiplier_z * w) % level.num_rows
            weight = math.prod(1 - abs(v - c - k) for v, c, k in zip(u, cell, corner, strict=True))
            values += weight * table[level.first_row + row]
        features += values.tolist()
    return features


def test_features_follow_the_documented_formula():
    table, z = table_of(LAYOUT), points_in(1.9, 40)
    expected = torch.tensor([looked_up(point, table, LAYOUT) for point in z.tolist()], dtype=z.dtype)
    assert torch.allclose(reference.encode(z, table, LAYOUT), expected, atol=1e-12)


def test_a_voxel_centre_returns_the_voxel():
    layout = build_layout((4,), num_features=1, log2_table_size=12, half_extent=1.0)
    table = table_of(layout)
    centres = torch.tensor([[-0.75, -0.75, -0.75], [0.75, -0.25, 0.25], [0.75, 0.75, 0.75]]).double()
    found = reference.encode(centres, table, layout)[:, 0]
    assert torch.allclose(found, table[torch.tensor([0, 3 + 4 + 32, 63]), 0])


@pytest.mark.parametrize("outside", [[2.0, 0.1, 0.2], [0.1, -3.0, 9.0]])
def test_points_outside_read_the_border_and_have_no_derivative_across_it(outside):
    z = torch.tensor([outside], dtype=torch.float64)
    table = table_of(LAYOUT)
    features, jacobian = reference.encode_with_jacobian(z, table, LAYOUT)
    assert torch.allclose(features, reference.encode(z.clamp(-1.5, 1.5), table, LAYOUT))
    assert not jacobian[0][:, z[0].abs() > 1.5].any()
    assert jacobian[0][:, z[0].abs() < 1.5].all()


def test_both_outputs_have_the_derivatives_that_differences_show():
    z = points_in(1.3, 6).requires_grad_()
    table = table_of(LAYOUT).requires_grad_()
    assert torch.autograd.gradcheck(
        lambda z, table: reference.encode_with_jacobian(z, table, LAYOUT),
        (z, table),
        eps=1e-7,
        fast_mode=True,
    )


def test_second_derivatives_are_those_that_differences_show():
    z = points_in(1.3, 4).requires_grad_()
    table = table_of(LAYOUT).requires_grad_()
    assert torch.autograd.gradgradcheck(
        lambda z, table: reference.encode(z, table, LAYOUT), (z, table), fast_mode=True
    )


def test_the_jacobian_is_the_derivative_of_the_features():
    z = points_in(1.9, 30).requires_grad_()
    features, jacobian = reference.encode_with_jacobian(z, table_of(LAYOUT), LAYOUT)
    for output in range(LAYOUT.num_outputs):
        (expected,) = torch.autograd.grad(features[:, output].sum(), z, retain_graph=True)
        assert torch.allclose(jacobian[:, output], expected, atol=1e-12)
