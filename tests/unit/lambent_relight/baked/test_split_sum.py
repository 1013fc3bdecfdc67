"""The specular lobe under uniform light: the table against the reflection model itself."""

import numpy as np
import pytest
from lambent_relight.baked.split_sum import split_sum, table
from lambent_relight.brdf import (
    Materials,
    brdf_cos,
    ggx_pdf,
    ggx_sample,
    half_vector,
    materials_from_roughness,
)
from support.statistics import assert_mean


def sampled_reflectance(cosine, roughness, f0, count=60000):
    """Return Monte Carlo estimates of the specular reflectance of a metal of albedo `f0`."""
    normal = np.broadcast_to(np.array([0.0, 0.0, 1.0]), (count, 3))
    omega_o = np.broadcast_to(np.array([np.sqrt(1.0 - cosine**2), 0.0, cosine]), (count, 3))
    alpha = materials_from_roughness(np.ones((count, 3)), np.full((count, 1), roughness), 1.0).alpha
    materials = Materials(np.full((count, 3), f0), alpha, np.ones((count, 1)))
    omega_i = ggx_sample(*np.random.default_rng(0).random((2, count)), omega_o, normal, alpha)
    half = half_vector(omega_o, omega_i, normal)
    _, specular = brdf_cos(omega_o, omega_i, normal, materials)
    pdf = ggx_pdf(half, alpha)
    return np.where(pdf > 0.0, specular / np.maximum(pdf, 1e-20), 0.0)[:, :1]


@pytest.mark.parametrize(
    ("cosine", "roughness"), [(1.0, 1.0), (0.7, 0.5), (0.3, 0.9), (0.5, 0.1), (0.1, 0.4), (0.05, 0.2)]
)
@pytest.mark.parametrize("f0", [0.04, 1.0])
def test_the_table_is_the_reflectance_of_the_lobe(cosine, roughness, f0):
    scale, bias = split_sum(np.array(cosine), np.array(roughness))
    samples = sampled_reflectance(cosine, roughness, f0)
    assert_mean(samples, np.array([f0 * scale + bias]), expected_error=4e-3)


def test_a_smooth_surface_reflects_as_fresnel_says():
    cosine = np.linspace(0.05, 1.0, 20)
    scale, bias = split_sum(cosine, np.zeros(20))
    np.testing.assert_allclose(bias, (1.0 - cosine) ** 5, atol=2e-2)
    np.testing.assert_allclose(scale + bias, 1.0, atol=5e-3)


def test_no_surface_reflects_more_than_it_gets():
    values = table()
    assert np.isfinite(values).all()
    assert values.min() >= 0.0
    assert values.sum(axis=-1).max() <= 1.0 + 1e-6


def test_shapes_are_broadcast_and_arguments_are_clipped():
    scale, bias = split_sum(np.array([[-0.2], [2.0]]), np.array([0.5, 1.5, -1.0]))
    assert scale.shape == bias.shape == (2, 3)
    inside, _ = split_sum(np.array([[0.0], [1.0]]), np.array([0.5, 1.0, 0.0]))
    np.testing.assert_array_equal(scale, inside)
