"""The network that predicts where light comes from."""

import math

import pytest
import torch
from flashcache.encoding.hash_grid import HashGridConfig
from flashcache.errors import ConfigError
from flashcache.losses.light_sampler import light_sampler_loss
from flashcache.physical.light_sampler import LightSampler, LightSamplerConfig
from support.shading import case, unit
from support.statements import estimates

GRID = HashGridConfig(base_resolution=4, finest_resolution=8, log2_table_size=12)


def _sampler(num_lights: int = 1, num_lobes: int = 8) -> LightSampler:
    torch.manual_seed(0)
    return LightSampler(LightSamplerConfig(grid=GRID, width=16, num_lobes=num_lobes), 1.0, num_lights)


def _positions(count: int = 5) -> torch.Tensor:
    return torch.rand(count, 3, generator=torch.Generator().manual_seed(2)) - 0.5


def test_the_mixture_has_unit_means_and_bounded_concentration():
    mixture = _sampler()(_positions(), torch.zeros(5, dtype=torch.long))
    assert mixture.means.shape == (5, 8, 3)
    torch.testing.assert_close(mixture.means.norm(dim=-1), torch.ones(5, 8))
    assert (mixture.kappa > 0.0).all()
    assert (mixture.kappa <= 50.0).all()


def test_a_fresh_sampler_has_a_total_amplitude_of_order_one_whatever_its_lobes():
    for num_lobes in (4, 128):
        mixture = _sampler(num_lobes=num_lobes)(_positions(), torch.zeros(5, dtype=torch.long))
        total = mixture.log_amplitude.exp().sum(dim=-1)
        torch.testing.assert_close(total, torch.full((5,), math.e), rtol=1e-2, atol=0.0)


def test_the_same_place_has_the_same_mixture_in_every_row_of_the_batch():
    sampler = _sampler()
    place = _positions(1).expand(3, 3)
    mixture = sampler(place, torch.zeros(3, dtype=torch.long))
    torch.testing.assert_close(mixture.means, mixture.means[:1].expand_as(mixture.means))


def test_every_point_looks_at_the_places_of_the_same_lobes():
    sampler, positions = _sampler(), 3.0 * _positions()
    torch.nn.init.zeros_(sampler.head.weight)
    torch.nn.init.zeros_(sampler.head.bias)
    means = sampler(positions, torch.zeros(5, dtype=torch.long)).means
    towards = sampler.config.position_spread * sampler.offsets - positions[:, None]
    torch.testing.assert_close(means, torch.nn.functional.normalize(towards, dim=-1))


def test_lights_have_mixtures_of_their_own():
    sampler = _sampler(num_lights=3)
    torch.nn.init.uniform_(sampler.grid.table, -1.0, 1.0)
    place = _positions(1).expand(3, 3)
    both = sampler(place, torch.tensor([0, 2, 0]))
    torch.testing.assert_close(both.means[0], both.means[2])
    assert (both.means[0] - both.means[1]).abs().max() > 1e-3


def test_positions_never_get_a_gradient_and_the_network_does():
    sampler = _sampler()
    positions = _positions().requires_grad_()
    mixture = sampler(positions, torch.zeros(5, dtype=torch.long))
    mixture.amplitude(torch.tensor([0.0, 0.0, 1.0]).expand(5, 1, 3)).sum().backward()
    assert positions.grad is None
    assert sampler.head.weight.grad.abs().max() > 0.0


def test_the_offsets_of_the_lobes_are_stored_with_the_model():
    assert torch.equal(_sampler().state_dict()["offsets"], _sampler().offsets)


def test_a_mixture_without_lobes_is_refused():
    with pytest.raises(ConfigError, match="num_lobes"):
        LightSamplerConfig(num_lobes=0)


@pytest.mark.slow
def test_training_turns_the_lobes_towards_the_light():
    torch.manual_seed(0)
    lamp = unit(0.6, -0.2, 0.7)

    def light(directions, light_index):
        return 0.05 + 8.0 * torch.exp(15.0 * (directions @ lamp - 1.0))[:, None] * torch.ones(3).double()

    given = case(256)
    sampler = _sampler(num_lobes=16).double()
    optimiser = torch.optim.Adam(sampler.parameters(), lr=1e-2)
    for step in range(150):
        mixture = sampler(given.points.positions, given.points.light_index)
        exact = estimates(given, control_variate="off", seed=step, light=light).exact
        optimiser.zero_grad()
        light_sampler_loss(mixture, exact).backward()
        optimiser.step()
    mixture = sampler(given.points.positions[:1], given.points.light_index[:1])
    towards, away = mixture.pdf(torch.stack([lamp, unit(-0.6, 0.2, 0.7)])[None])[0].tolist()
    assert towards > 10.0 * away
