from dataclasses import replace

import pytest
import torch
from flashcache.losses.priors import grey_prior, tint_prior
from flashcache.training.joint_losses import environment_terms
from support.joint_stage import stage


def test_a_blue_sky_with_a_red_sun_has_no_tint_where_their_sum_is_white():
    radiance = torch.tensor([[0.2, 0.5, 0.9], [0.9, 0.6, 0.2]])
    assert float(tint_prior(radiance)) == pytest.approx(0.0, abs=1e-6)
    assert float(grey_prior(radiance)) > 0.1


def test_tint_is_relative_to_the_brightness_of_the_light():
    radiance = torch.rand(64, 3) * torch.tensor([1.3, 1.0, 0.2])
    assert float(tint_prior(7.0 * radiance)) == pytest.approx(float(tint_prior(radiance)), rel=1e-4)


def test_tint_of_a_known_colour():
    radiance = torch.tensor([2.0, 1.0, 0.5]).expand(9, 3)
    assert float(tint_prior(radiance)) == pytest.approx(2.0 / 3.0 * torch.tensor(2.0).log().item() ** 2)


def test_light_without_a_channel_has_a_finite_gradient_that_brings_it_back():
    radiance = torch.tensor([[1.0, 1.0, 0.0]], requires_grad=True)
    tint_prior(radiance).backward()
    assert torch.isfinite(radiance.grad).all()
    raised = torch.tensor([[1.0, 1.0, 1e-3]], requires_grad=True)
    tint_prior(raised).backward()
    assert float(raised.grad[0, 2]) < 0.0


@pytest.mark.parametrize(("name", "other"), [("grey", "tint"), ("tint", "grey")])
def test_each_prior_has_a_weight_of_its_own(name: str, other: str):
    made = stage()
    config = replace(made.config, **{f"{name}_weight": 0.5, f"{other}_weight": 0.0})
    terms = environment_terms(made.model, config, torch.Generator().manual_seed(0))
    twice = replace(config, **{f"{name}_weight": 1.0})
    more = environment_terms(made.model, twice, torch.Generator().manual_seed(0))
    assert list(terms) == [name]
    assert more[name].item() == pytest.approx(2.0 * terms[name].item())


def test_known_light_has_no_prior():
    made = stage()
    made.model.environment.register_buffer("learned_lights", torch.zeros(0, dtype=torch.long))
    assert environment_terms(made.model, made.config, torch.Generator()) == {}
