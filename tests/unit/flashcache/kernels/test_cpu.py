"""The compiled encoder against the reference."""

import numpy as np
import pytest
import torch
from flashcache.kernels import cpu, reference
from support.grid_cases import LAYOUTS, case, close


@pytest.mark.parametrize("layout", LAYOUTS.values(), ids=LAYOUTS.keys())
def test_features_and_jacobian_equal_the_reference(layout):
    z, table, _, _ = case(layout)
    features, jacobian = cpu.encode_with_jacobian(z, table, layout, 1)
    expected = reference.encode_with_jacobian(torch.from_numpy(z), torch.from_numpy(table), layout)
    assert close(features, expected[0])
    assert close(jacobian, expected[1])
    assert close(cpu.encode(z, table, layout, 1), expected[0])


@pytest.mark.parametrize("layout", LAYOUTS.values(), ids=LAYOUTS.keys())
def test_gradients_of_features_equal_the_reference(layout):
    z, table, by_features, _ = case(layout)
    points, values = torch.from_numpy(z).requires_grad_(), torch.from_numpy(table).requires_grad_()
    reference.encode(points, values, layout).backward(torch.from_numpy(by_features))
    gradient = np.full_like(table, np.nan)
    cpu.add_table_gradient(z, layout, by_features, None, gradient, 1, overwrite=True)
    assert close(gradient, values.grad)
    assert close(cpu.position_gradient(z, table, layout, by_features, 1), points.grad)


@pytest.mark.parametrize("layout", LAYOUTS.values(), ids=LAYOUTS.keys())
def test_gradients_of_features_and_jacobian_equal_the_reference(layout):
    z, table, by_features, by_jacobian = case(layout)
    values = torch.from_numpy(table).requires_grad_()
    outputs = reference.encode_with_jacobian(torch.from_numpy(z), values, layout)
    torch.autograd.backward(outputs, [torch.from_numpy(by_features), torch.from_numpy(by_jacobian)])
    gradient = np.zeros_like(table)
    cpu.add_table_gradient(z, layout, by_features, by_jacobian, gradient, 1)
    assert close(gradient, values.grad)


def test_gradients_are_added_to_what_is_there():
    layout = LAYOUTS["mixed, 2 features"]
    z, table, by_features, _ = case(layout, 50)
    once, twice = np.zeros_like(table), np.zeros_like(table)
    cpu.add_table_gradient(z, layout, by_features, None, once, 1)
    cpu.add_table_gradient(z, layout, by_features, None, twice, 1)
    cpu.add_table_gradient(z, layout, by_features, None, twice, 1)
    assert np.allclose(twice, 2.0 * once, rtol=1e-5, atol=1e-5)
    assert once.any()


@pytest.mark.parametrize("layout", LAYOUTS.values(), ids=LAYOUTS.keys())
def test_results_do_not_depend_on_the_number_of_threads(layout):
    z, table, by_features, by_jacobian = case(layout, 9001)
    results = []
    for num_threads in (1, 2, 3):
        gradient = np.zeros_like(table)
        cpu.add_table_gradient(z, layout, by_features, by_jacobian, gradient, num_threads)
        forward = cpu.encode_with_jacobian(z, table, layout, num_threads)
        positions = cpu.position_gradient(z, table, layout, by_features, num_threads)
        results.append((cpu.encode(z, table, layout, num_threads), *forward, positions, gradient))
    for other in results[1:]:
        for a, b in zip(results[0], other, strict=True):
            assert np.array_equal(a, b)


def test_a_point_that_is_not_a_number_reads_inside_the_table():
    layout = LAYOUTS["mixed, 2 features"]
    table = case(layout, 10)[1]
    z = np.full((1, 3), np.nan, np.float32)
    corner = np.full((1, 3), -layout.half_extent, np.float32)
    assert np.array_equal(cpu.encode(z, table, layout, 1), cpu.encode(corner, table, layout, 1))


def test_no_points_give_no_features_and_no_gradient():
    layout = LAYOUTS["mixed, 2 features"]
    table = case(layout, 10)[1]
    nothing = np.empty((0, 3), np.float32)
    gradient = np.zeros_like(table)
    cpu.add_table_gradient(nothing, layout, np.empty((0, layout.num_outputs), np.float32), None, gradient, 2)
    assert cpu.encode(nothing, table, layout, 2).shape == (0, layout.num_outputs)
    assert not gradient.any()
