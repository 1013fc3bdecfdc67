"""Bytes of operations, and their times beside them."""

import pytest
import torch
from flashcache.encoding.hash_grid import HashGridConfig

from benchmarks.gpu_limits import Case, differentiable, grid_cases, measured, mixture_case, points_of

CPU = torch.device("cpu")
SMALL = HashGridConfig(finest_resolution=32, num_features=2, log2_table_size=12)


def test_bytes_count_each_tensor_once_and_rows_each_time():
    features, both = grid_cases("small", SMALL, points_of(64, CPU))
    rows = 64 * 2 * 8 * 2 * 4  # Points, levels, corners, features, bytes.
    positions, outputs = 64 * 3 * 4, 64 * 2 * 2 * 4
    assert features.rows == both.rows == rows
    assert features.bytes == positions + outputs + min(rows, 2 * 4096 * 2 * 4)
    assert both.bytes - features.bytes == 3 * outputs


def test_a_table_is_read_no_more_often_than_once():
    (few, _), (many, _) = (grid_cases("small", SMALL, points_of(count, CPU)) for count in (64, 64000))
    outputs = 64000 * 2 * 2 * 4
    assert many.bytes == 64000 * 3 * 4 + outputs + 2 * 4096 * 2 * 4
    assert few.bytes < many.bytes


def test_points_lie_on_rays_within_the_cube():
    points = points_of(96, CPU)
    assert points.shape == (96, 3)
    assert points.abs().max() <= 1.0
    steps = points.reshape(3, 32, 3).diff(dim=1)
    torch.testing.assert_close(steps, steps[:, :1].expand_as(steps), atol=1e-6, rtol=1e-4)


def test_gradients_by_inputs_are_not_summed_over_repeats():
    values = torch.ones(3, requires_grad=True)
    _, backward = differentiable(lambda: 2.0 * values, (values,))
    backward()
    backward()
    assert torch.equal(values.grad, torch.full((3,), 2.0))


def test_operations_with_and_without_a_gradient_have_rows():
    case = mixture_case(4, CPU)
    alone = Case(name="alone", make=lambda: (lambda: None, None), bytes=1000)
    rows = [row for one in (case, alone) for row in measured(one, CPU, 2, 1e9)]
    assert [row["name"] for row in rows] == [case.name, f"{case.name}: gradient", "alone"]
    assert rows[2]["limit_ms"] == pytest.approx(1e-3)
    assert all(row["plain"]["repeats"] == 2 for row in rows)
