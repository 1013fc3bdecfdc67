"""The compiled encoder against the reference."""

import pytest
import torch
from flashcache.kernels import cpu, reference
from support.grid_cases import LAYOUTS, case, close

MIXED = LAYOUTS["mixed, 2 features"]
every_layout = pytest.mark.parametrize("layout", LAYOUTS.values(), ids=LAYOUTS.keys())


def tensors(layout, count: int = 3000) -> list[torch.Tensor]:
    return [torch.from_numpy(values) for values in case(layout, count)]


@every_layout
def test_features_and_jacobian_equal_the_reference(layout):
    z, table, _, _ = tensors(layout)
    expected = reference.encode_with_jacobian(z, table, layout)
    for found, wanted in zip(cpu.encode_with_jacobian(z, table, layout), expected, strict=True):
        assert close(found.numpy(), wanted)
    assert close(cpu.encode(z, table, layout).numpy(), expected[0])


@every_layout
@pytest.mark.parametrize("with_jacobian", [False, True])
def test_gradients_equal_the_reference(layout, with_jacobian):
    z, table, by_features, by_jacobian = tensors(layout)
    points, values = z.clone().requires_grad_(), table.clone().requires_grad_()
    gradient = torch.full_like(table, torch.nan)
    if with_jacobian:
        outputs = reference.encode_with_jacobian(z, values, layout)
        torch.autograd.backward(outputs, [by_features, by_jacobian])
    else:
        reference.encode(points, values, layout).backward(by_features)
        assert close(cpu.position_gradient(z, table, layout, by_features).numpy(), points.grad)
    by_jacobian = by_jacobian if with_jacobian else None
    cpu.add_table_gradient(z, layout, by_features, by_jacobian, gradient, overwrite=True)
    assert close(gradient.numpy(), values.grad)


def test_gradients_are_added_to_what_the_buffer_holds():
    z, table, by_features, _ = tensors(MIXED, 50)
    once, twice = torch.zeros_like(table), torch.zeros_like(table)
    for buffer in (once, twice, twice):
        cpu.add_table_gradient(z, MIXED, by_features, None, buffer)
    torch.testing.assert_close(twice, 2.0 * once, rtol=1e-5, atol=1e-5)
    assert once.any()


@every_layout
def test_results_do_not_depend_on_the_number_of_threads(layout, monkeypatch):
    z, table, by_features, by_jacobian = tensors(layout, 9001)
    results = []
    for num_threads in (1, 2, 3):
        monkeypatch.setattr(torch, "get_num_threads", lambda count=num_threads: count)
        gradient = torch.zeros_like(table)
        cpu.add_table_gradient(z, layout, by_features, by_jacobian, gradient)
        forward = cpu.encode_with_jacobian(z, table, layout)
        positions = cpu.position_gradient(z, table, layout, by_features)
        results.append((cpu.encode(z, table, layout), *forward, positions, gradient))
    for other in results[1:]:
        assert all(torch.equal(a, b) for a, b in zip(results[0], other, strict=True))


def test_a_point_that_is_not_a_number_reads_inside_the_table():
    table = tensors(MIXED, 10)[1]
    z, corner = torch.full((1, 3), torch.nan), torch.full((1, 3), -MIXED.half_extent)
    assert torch.equal(cpu.encode(z, table, MIXED), cpu.encode(corner, table, MIXED))


def test_no_points_give_no_features_and_no_gradient():
    table, nothing = tensors(MIXED, 10)[1], torch.empty(0, 3)
    gradient = torch.zeros_like(table)
    cpu.add_table_gradient(nothing, MIXED, torch.empty(0, MIXED.num_outputs), None, gradient)
    assert cpu.encode(nothing, table, MIXED).shape == (0, MIXED.num_outputs)
    assert not gradient.any()
