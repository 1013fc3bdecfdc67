"""The loss that teaches the light sampler how bright directions are."""

import torch
from flashcache.color import loss_curve
from flashcache.losses.light_sampler import light_sampler_loss
from flashcache.physical.light_sampler import VmfMixture
from support.shading import case, peaked_mixture, unit
from support.statements import estimates


def test_the_loss_is_zero_where_the_amplitude_is_the_radiance():
    given = case(50)
    exact = estimates(given, control_variate="off", light=lambda d, _: torch.zeros_like(d)).exact
    mixture = peaked_mixture(given.rows, unit(0.5, -0.1, 0.8))
    radiance = mixture.amplitude(exact.omega_i)[..., None] * torch.tensor([1.0, 0.0, 0.0]).double()
    same = type(exact)(**{**vars(exact), "radiance": radiance})
    assert float(light_sampler_loss(mixture, same)) == 0.0
    assert float(light_sampler_loss(mixture, exact)) > 0.0


def test_directions_below_the_surface_do_not_teach_the_sampler():
    given = case(50, alpha=1.0)
    exact = estimates(given, control_variate="off").exact
    mixture = peaked_mixture(given.rows, unit(0.5, -0.1, 0.8))
    changed = type(exact)(
        **{**vars(exact), "radiance": torch.where(exact.above[..., None], exact.radiance, 9.0)}
    )
    assert not exact.above.all()
    assert float(light_sampler_loss(mixture, exact)) == float(light_sampler_loss(mixture, changed))


def test_the_gradient_of_the_loss_is_minus_the_residual_times_that_of_the_amplitude():
    given = case(4)
    exact = estimates(given, control_variate="off").exact
    mixture = peaked_mixture(given.rows, unit(0.5, -0.1, 0.8))
    amplitude = mixture.log_amplitude.clone().requires_grad_()
    light_sampler_loss(VmfMixture(mixture.means, mixture.kappa, amplitude), exact).backward()
    # One of the two residuals is detached: the gradient is that of half the square.
    moved = amplitude.detach().clone().requires_grad_()
    model = VmfMixture(mixture.means, mixture.kappa, moved)
    residual = loss_curve(exact.radiance.norm(dim=-1)) - loss_curve(model.amplitude(exact.omega_i))
    weight = exact.mis_weight * exact.above / exact.pdf_solid_angle.clamp_min(0.01)
    terms = 0.5 * residual.square() * weight
    (0.5 * (terms[:, :2].mean() + terms[:, 2:].mean())).backward()
    torch.testing.assert_close(amplitude.grad, moved.grad)
