"""The feature grid as a module."""

from dataclasses import replace

import pytest
import torch
from flashcache.encoding.hash_grid import HashGrid, HashGridConfig
from flashcache.errors import ConfigError

CONFIG = HashGridConfig(base_resolution=4, finest_resolution=40, num_levels=3, log2_table_size=12)


def grid(config: HashGridConfig = CONFIG) -> HashGrid:
    made = HashGrid(config)
    with torch.no_grad():
        made.table.normal_(generator=torch.Generator().manual_seed(0))
    return made


def test_features_keep_the_shape_of_the_batch():
    features, jacobian = grid().encode_with_jacobian(torch.zeros(2, 5, 3))
    assert features.shape == (2, 5, 6)
    assert jacobian.shape == (2, 5, 6, 3)
    assert torch.equal(features, grid()(torch.zeros(2, 5, 3)))


def test_the_table_starts_small():
    table = HashGrid(CONFIG).table
    assert 0.9e-4 < table.abs().max() <= 1e-4


def test_features_are_the_scale_times_the_table_and_start_alike():
    once, tenfold = grid(), grid(replace(CONFIG, output_scale=10.0))
    z = torch.rand(50, 3, generator=torch.Generator().manual_seed(1))
    for one, ten in zip(once.encode_with_jacobian(z), tenfold.encode_with_jacobian(z), strict=True):
        torch.testing.assert_close(ten, 10.0 * one)
    before = tenfold(z)
    tenfold.fold_scale()
    torch.testing.assert_close(tenfold(z), before)
    torch.testing.assert_close(tenfold.table, 10.0 * once.table)
    assert 0.9e-5 < HashGrid(replace(CONFIG, output_scale=10.0)).table.abs().max() <= 1e-5


@pytest.mark.parametrize(
    "setting", [{"num_features": 0}, {"half_extent": 0.0}, {"num_levels": -1}, {"output_scale": 0.0}]
)
def test_settings_out_of_range_are_refused(setting):
    with pytest.raises(ConfigError, match=next(iter(setting))):
        HashGridConfig(**setting)


def test_normals_from_the_jacobian_equal_those_of_double_backward():
    """The gradient of a density by position, and of a loss on it by every parameter, both ways."""
    torch.manual_seed(1)
    made = grid().double()
    network = torch.nn.Sequential(
        torch.nn.Linear(6, 16), torch.nn.Softplus(), torch.nn.Linear(16, 1)
    ).double()
    parameters = [made.table, *network.parameters()]
    z = torch.rand(50, 3, dtype=torch.float64) * 1.8 - 0.9

    features, jacobian = made.encode_with_jacobian(z)
    (by_feature,) = torch.autograd.grad(network(features).sum(), features, create_graph=True)
    normal = torch.einsum("pf,pfk->pk", by_feature, jacobian)
    found = torch.autograd.grad(normal.square().sum(), parameters, allow_unused=True)

    position = z.clone().requires_grad_()
    (expected_normal,) = torch.autograd.grad(network(made(position)).sum(), position, create_graph=True)
    expected = torch.autograd.grad(expected_normal.square().sum(), parameters, allow_unused=True)
    assert torch.allclose(normal, expected_normal)
    assert all(torch.allclose(a, b) for a, b in zip(found, expected, strict=True) if a is not None)


def test_compiled_normals_train_the_table_like_the_reference():
    torch.manual_seed(1)
    single = grid()
    double = grid().double()
    z = torch.rand(200, 3) * 1.8 - 0.9
    gradients = []
    for made in (single, double):
        _, jacobian = made.encode_with_jacobian(z.to(made.table.dtype))
        torch.nn.functional.normalize(jacobian.sum(dim=1), dim=-1)[:, 0].sum().backward()
        gradients.append(made.table.grad.double())
    assert torch.allclose(*gradients, rtol=1e-3, atol=1e-4 * gradients[1].abs().max().item())


def test_checkpoints_hold_the_hash_and_a_table_of_another_is_refused():
    state = grid().state_dict()
    copy = HashGrid(CONFIG)
    copy.load_state_dict(state)
    assert torch.equal(copy.table, state["table"])
    state["levels"] = state["levels"].clone()
    state["levels"][2, 3] += 1
    with pytest.raises(RuntimeError, match="another hash"):
        HashGrid(CONFIG).load_state_dict(state)


def test_a_table_of_another_size_is_refused():
    with pytest.raises(RuntimeError, match="other levels"):
        HashGrid(HashGridConfig(log2_table_size=12)).load_state_dict(grid().state_dict())
