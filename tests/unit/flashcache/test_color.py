"""The sRGB curve, the loss curve and the roughness conversion."""

import torch
from flashcache.color import (
    alpha_from_perceptual_roughness,
    linear_from_srgb,
    loss_curve,
    perceptual_roughness_from_alpha,
    srgb_from_linear,
)


def test_the_curve_has_the_values_of_the_standard():
    linear = torch.tensor([0.0, 0.001, 0.0031308, 0.18, 0.5, 1.0], dtype=torch.float64)
    known = torch.tensor([0.0, 0.01292, 0.04045, 0.46135613, 0.73535698, 1.0], dtype=torch.float64)
    torch.testing.assert_close(srgb_from_linear(linear), known, atol=1e-6, rtol=0.0)


def test_decoding_undoes_encoding_on_both_pieces():
    linear = torch.cat([torch.linspace(0.0, 0.01, 101), torch.linspace(0.01, 4.0, 100)]).double()
    torch.testing.assert_close(linear_from_srgb(srgb_from_linear(linear)), linear, atol=2e-7, rtol=1e-6)


def test_all_256_codes_of_a_picture_survive_the_round_trip():
    codes = torch.arange(256) / 255.0
    assert torch.equal((srgb_from_linear(linear_from_srgb(codes)) * 255.0).round(), torch.arange(256.0))


def test_gradients_are_finite_at_zero_and_below():
    linear = torch.tensor([-0.1, 0.0, 1e-9, 0.0031308], requires_grad=True)
    srgb_from_linear(linear).sum().backward()
    torch.testing.assert_close(linear.grad[:3], torch.full((3,), 12.92))
    assert torch.isfinite(linear.grad).all()


def test_the_loss_curve_does_not_clip_bright_values_and_has_a_floor():
    bright = loss_curve(torch.tensor([1.0, 10.0, 100.0]))
    assert bright[0] < bright[1] < bright[2]
    assert loss_curve(torch.tensor(0.0)) == loss_curve(torch.tensor(1e-5)) > 0.0
    assert loss_curve(torch.tensor(1e-6)) < loss_curve(torch.tensor(2e-5))


def test_perceptual_roughness_is_the_root_of_alpha_and_back():
    alpha = torch.tensor([0.0001, 0.04, 0.25, 1.0])
    torch.testing.assert_close(perceptual_roughness_from_alpha(alpha), torch.tensor([0.01, 0.2, 0.5, 1.0]))
    torch.testing.assert_close(alpha_from_perceptual_roughness(perceptual_roughness_from_alpha(alpha)), alpha)
