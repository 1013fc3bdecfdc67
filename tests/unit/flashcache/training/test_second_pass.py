"""Pass B gives the same step on one core and on two, and the gradient that one graph of both would have."""

from dataclasses import replace

import pytest
import torch
from flashcache.presets import tiny
from flashcache.training.joint_losses import physical_loss
from flashcache.training.passes import shade
from flashcache.training.second_pass import SecondPass, half_the_threads, twin_of
from flashcache.volume.quadrature import composite
from support.joint_stage import stage


@pytest.fixture
def threads():
    """Return a function that sets torch's threads, and set them back after the test."""
    before = torch.get_num_threads()
    yield torch.set_num_threads
    torch.set_num_threads(before)


def weights_after(threads, count: int, **settings) -> dict[str, torch.Tensor]:
    threads(count)
    made = stage(**settings)
    assert made.second.parallel == (count > 1)
    # Outside the passes one thread in both, so that only their order in time differs.
    threads(1)
    for _ in range(3):
        made.step()
    return made.model.state_dict()


@pytest.mark.parametrize("symmetric", [True, False])
def test_two_cores_take_the_same_step_as_one_bit_for_bit(threads, symmetric):
    alone = weights_after(threads, 1, symmetric=symmetric)
    together = weights_after(threads, 2, symmetric=symmetric)
    assert all(torch.equal(alone[name], together[name]) for name in alone)


@pytest.mark.parametrize("settings", [{}, {"through_cache": 1e-2}])
def test_gradients_are_those_of_one_graph_with_both_passes(settings):
    estimator = replace(tiny().stage_two.estimator, **settings)
    made = stage(symmetric=True, estimator=estimator)
    made.step()
    # After a step, so that a twin that missed the update would be noticed.
    config, model = made.config, made.model
    batch = made.pixels.draw(48, torch.Generator().manual_seed(2))

    def traced():
        made.optimiser.zero_grad(set_to_none=False)
        generators = [torch.Generator().manual_seed(seed) for seed in (3, 4, 5)]
        geometry = model.nerf.trace(batch.rays, generator=generators[0])
        radiance = model.nerf.outgoing(geometry, batch.rays.directions, batch.light_index).radiance
        return geometry, composite(geometry.weights, radiance), *generators[1:]

    geometry, cache, one, two = traced()
    first, second = (shade(model, config, batch, geometry, generator).picture for generator in (one, two))
    loss = physical_loss(config, batch, cache, first, second)
    (loss + physical_loss(config, batch, cache, second, first)).backward()
    expected = {n: p.grad.clone() for n, p in model.named_parameters() if p.grad is not None}
    assert expected["materials.head.weight"].any()

    geometry, cache, one, two = traced()
    made.second.start(batch, geometry, two)
    first = shade(model, config, batch, geometry, one).picture
    second = made.second.result().picture
    leaf = second.detach().requires_grad_()
    other = physical_loss(config, batch, cache, leaf, first)
    made.second.differentiate(second, *torch.autograd.grad(other, leaf))
    physical_loss(config, batch, cache, first, second).backward(retain_graph=True)
    made.second.collect(geometry)
    for name, gradient in expected.items():
        tiniest = 1e-5 * float(gradient.abs().max()) + 1e-12
        found = model.get_parameter(name).grad
        torch.testing.assert_close(found, gradient, rtol=1e-4, atol=tiniest)


def test_a_twin_shares_values_and_not_gradients():
    model = stage().model
    twin = twin_of(model)
    with torch.no_grad():
        model.materials.head.bias.add_(1.0)
    assert torch.equal(twin.materials.head.bias, model.materials.head.bias)
    twin.materials.head.bias.sum().backward()
    assert model.materials.head.bias.grad is None or not model.materials.head.bias.grad.any()
    assert twin.light_sampler.offsets is model.light_sampler.offsets


def test_a_failure_in_the_second_pass_ends_the_step(threads, monkeypatch):
    threads(2)
    made = stage()

    def broken(*arguments, **options):
        raise RuntimeError("no light")

    monkeypatch.setattr("flashcache.training.second_pass.shade", broken)
    with pytest.raises(RuntimeError, match="no light"):
        made.step()


def test_operations_get_their_threads_back(threads):
    threads(2)
    with half_the_threads(active=True):
        assert torch.get_num_threads() == 1
    assert torch.get_num_threads() == 2
    with half_the_threads(active=False):
        assert torch.get_num_threads() == 2


def test_without_symmetry_the_second_pass_is_a_constant():
    made = stage(symmetric=False)
    _, _, _, collect = made.losses()
    assert collect is None
    assert not made.second.result().picture.requires_grad
    assert isinstance(made.second, SecondPass)
