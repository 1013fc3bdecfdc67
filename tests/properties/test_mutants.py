"""Classic mistakes, made on purpose: the statements about estimators must notice them."""

import pytest
import torch
from flashcache.physical import estimator, sampling, shading
from flashcache.physical.sampling import GgxLobe
from support.shading import case
from support.statements import (
    assert_estimates_agree_with_quadrature,
    assert_gradients_agree_with_quadrature,
    assert_two_passes_minimise_the_error_of_the_mean,
)

ROWS = 20000


class _TorchThatTracksGradients:
    """torch, except that no block is left without gradients."""

    def __getattr__(self, name: str):
        return torch.enable_grad if name == "no_grad" else getattr(torch, name)


def test_dropping_the_cosine_of_the_specular_lobe_is_noticed(monkeypatch):
    right = shading.specular_brdf_cos

    def without_cosine(omega_o, omega_i, normal, materials):
        cosine = (normal * omega_i).sum(dim=-1, keepdim=True).clamp_min(1e-6)
        return right(omega_o, omega_i, normal, materials) / cosine

    monkeypatch.setattr(shading, "specular_brdf_cos", without_cosine)
    with pytest.raises(AssertionError, match="standard errors"):
        assert_estimates_agree_with_quadrature(case(ROWS))


def test_dropping_the_cosine_of_the_diffuse_lobe_is_noticed(monkeypatch):
    right = shading.lambert_cos
    monkeypatch.setattr(shading, "lambert_cos", lambda *arguments: (right(*arguments) > 0.0) / torch.pi)
    with pytest.raises(AssertionError, match="standard errors"):
        assert_estimates_agree_with_quadrature(case(ROWS))


def test_swapping_the_directions_of_light_and_viewer_is_noticed(monkeypatch):
    right = shading.specular_brdf_cos

    def swapped(omega_o, omega_i, normal, materials):
        return right(omega_i, omega_o, normal, materials)

    monkeypatch.setattr(shading, "specular_brdf_cos", swapped)
    with pytest.raises(AssertionError, match="standard errors"):
        assert_estimates_agree_with_quadrature(case(ROWS))


def test_using_one_sample_in_both_passes_is_noticed():
    with pytest.raises(AssertionError, match="standard errors"):
        assert_two_passes_minimise_the_error_of_the_mean(ROWS, independent=False)


def test_forgetting_the_correction_is_noticed():
    with pytest.raises(AssertionError, match="standard errors"):
        assert_estimates_agree_with_quadrature(case(ROWS), control_variate="fast_only")


def test_letting_gradients_follow_the_directions_is_noticed(monkeypatch):
    attached: dict[str, torch.Tensor] = {}

    class AttachedLobe(GgxLobe):
        """Directions that move with normal and width, densities that do not: the public code's choice."""

        def pdf(self, omega_i):
            return super().pdf(omega_i).detach()

    def attached_lobe(omega_o, normal, alpha):
        return AttachedLobe(omega_o, attached["normal"], attached["alpha"])

    right = estimator.control_variate

    def remember(points, materials, **arguments):
        attached.update(normal=points.normal, alpha=materials.alpha)
        return right(points, materials, **arguments)

    for module in (sampling, shading):
        monkeypatch.setattr(module, "torch", _TorchThatTracksGradients())
    monkeypatch.setattr(estimator, "GgxLobe", attached_lobe)
    monkeypatch.setattr("support.statements.control_variate", remember)
    with pytest.raises(AssertionError, match="standard errors"):
        assert_gradients_agree_with_quadrature(ROWS, alpha=0.4)
