"""The reflectance model against its textbook form, written out for one direction at a time."""

import math

import pytest
import torch
from flashcache.physical.brdf import (
    Materials,
    brdf_cos,
    diffuse_albedo,
    ggx_density,
    specular_brdf_cos,
)
from support.shading import unit

NORMAL = unit(0.2, -0.1, 0.95)
OMEGA_I = unit(0.7, 0.1, 0.5)
OMEGA_O = unit(-0.4, 0.3, 0.6)


def _materials(albedo=(0.8, 0.5, 0.1), alpha=0.3, metalness=0.4) -> Materials:
    return Materials(
        torch.tensor(albedo, dtype=torch.float64),
        torch.tensor([alpha], dtype=torch.float64),
        torch.tensor([metalness], dtype=torch.float64),
    )


def _textbook(omega_o, omega_i, normal, materials) -> list[float]:
    """Return f_spec * (n.omega_i) per channel by the formulas D F G / (4 (n.i)(n.o)), in plain numbers."""
    half = [i + o for i, o in zip(omega_i.tolist(), omega_o.tolist(), strict=True)]
    length = math.sqrt(sum(h * h for h in half))
    half = [h / length for h in half]

    def dot(a, b):
        return sum(x * y for x, y in zip(a, b, strict=True))

    n = normal.tolist()
    n_i, n_o, n_h = dot(n, omega_i.tolist()), dot(n, omega_o.tolist()), dot(n, half)
    i_h = dot(omega_i.tolist(), half)
    alpha, metal = float(materials.alpha), float(materials.metalness)
    d = alpha**2 / (math.pi * (n_h**2 * (alpha**2 - 1.0) + 1.0) ** 2)
    k = alpha / 2.0
    g = n_i / (n_i * (1.0 - k) + k) * n_o / (n_o * (1.0 - k) + k)
    result = []
    for albedo in materials.albedo.tolist():
        f0 = metal * albedo + (1.0 - metal) * 0.04
        fresnel = f0 + (1.0 - f0) * (1.0 - i_h) ** 5
        result.append(d * fresnel * g / (4.0 * n_i * n_o) * n_i)
    return result


@pytest.mark.parametrize("alpha", [0.01, 0.3, 1.0])
@pytest.mark.parametrize("metalness", [0.0, 0.4, 1.0])
def test_the_specular_lobe_is_the_textbook_product(alpha, metalness):
    materials = _materials(alpha=alpha, metalness=metalness)
    value = specular_brdf_cos(OMEGA_O, OMEGA_I, NORMAL, materials)
    expected = torch.tensor(_textbook(OMEGA_O, OMEGA_I, NORMAL, materials), dtype=torch.float64)
    torch.testing.assert_close(value, expected)


def test_the_diffuse_lobe_is_the_dielectric_share_of_the_albedo_over_pi():
    materials = _materials()
    diffuse, _ = brdf_cos(OMEGA_O, OMEGA_I, NORMAL, materials)
    expected = 0.6 * materials.albedo / math.pi * NORMAL.dot(OMEGA_I)
    torch.testing.assert_close(diffuse, expected)
    torch.testing.assert_close(diffuse_albedo(materials), 0.6 * materials.albedo)


def test_nothing_is_reflected_from_below_the_surface_nor_to_below_it():
    below = -NORMAL + 0.2 * OMEGA_I
    below = below / below.norm()
    diffuse, specular = brdf_cos(OMEGA_O, below, NORMAL, _materials())
    assert diffuse.abs().max() == 0.0
    assert specular.abs().max() == 0.0
    assert specular_brdf_cos(below, OMEGA_I, NORMAL, _materials()).abs().max() == 0.0


def test_the_reflectance_without_cosine_is_reciprocal():
    materials = _materials()
    there = specular_brdf_cos(OMEGA_O, OMEGA_I, NORMAL, materials) / NORMAL.dot(OMEGA_I)
    back = specular_brdf_cos(OMEGA_I, OMEGA_O, NORMAL, materials) / NORMAL.dot(OMEGA_O)
    torch.testing.assert_close(there, back)


def test_a_metal_has_no_diffuse_lobe_and_reflects_its_albedo_head_on():
    materials = _materials(metalness=1.0, alpha=0.5)
    diffuse, metal = brdf_cos(NORMAL, NORMAL, NORMAL, materials)
    white = specular_brdf_cos(NORMAL, NORMAL, NORMAL, _materials((1.0, 1.0, 1.0), 0.5, 1.0))
    assert diffuse.abs().max() == 0.0
    torch.testing.assert_close(metal / white, materials.albedo)


def test_the_density_keeps_its_digits_in_float32_for_nearly_perfect_mirrors():
    alpha = torch.tensor([3e-4])
    angle = torch.tensor([0.0, 1e-4, 3e-4, 1e-3], dtype=torch.float64)
    half = torch.stack([angle.sin(), torch.zeros_like(angle), angle.cos()], dim=-1)
    normal = torch.tensor([0.0, 0.0, 1.0])
    exact = ggx_density(normal.double(), half, alpha.double())
    torch.testing.assert_close(ggx_density(normal, half.float(), alpha).double(), exact, rtol=1e-3, atol=0.0)


def test_gradients_agree_with_finite_differences():
    def both(normal, albedo, alpha, metalness):
        lobes = brdf_cos(OMEGA_O, OMEGA_I, normal, Materials(albedo, alpha, metalness))
        return torch.cat(lobes)

    materials = _materials()
    inputs = [NORMAL, materials.albedo, materials.alpha, materials.metalness]
    inputs = [value.clone().requires_grad_() for value in inputs]
    assert torch.autograd.gradcheck(both, inputs)


def test_gradients_stay_finite_at_grazing_and_back_facing_directions():
    normal = torch.tensor([0.0, 0.0, 1.0]).expand(4, 3).clone().requires_grad_()
    omega_o = torch.tensor([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    omega_i = torch.tensor([[-1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    alpha = torch.full((4, 1), 1e-4, requires_grad=True)
    materials = Materials(torch.full((4, 3), 0.5), alpha, torch.full((4, 1), 0.5))
    diffuse, specular = brdf_cos(omega_o, omega_i, normal, materials)
    (diffuse + specular).sum().backward()
    assert torch.isfinite(normal.grad).all()
    assert torch.isfinite(alpha.grad).all()
