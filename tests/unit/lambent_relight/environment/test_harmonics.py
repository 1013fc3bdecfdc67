"""Spherical harmonics against quadrature, and the symmetries they promise."""

import math

import numpy as np
import pytest
from lambent_core.directions import normalise, pixel_directions, pixel_solid_angles, rotate_about_z
from lambent_core.errors import SettingError
from lambent_relight.environment.harmonics import basis, cosine_factors, project, rotate_z
from lambent_relight.environment.maps import environment_from_array

BANDS = 7


def random_map(height=12, width=24, seed=0):
    return environment_from_array(np.random.default_rng(seed).gamma(0.5, 2.0, (height, width, 3)))


def sphere(height=96):
    """Return directions [n, 3] and their solid angles [n]."""
    weights = np.repeat(pixel_solid_angles(height, 2 * height), 2 * height)
    return pixel_directions(height, 2 * height).reshape(-1, 3), weights


def test_the_basis_is_orthonormal():
    directions, weights = sphere()
    values = basis(directions, BANDS)
    np.testing.assert_allclose((values * weights[:, None]).T @ values, np.eye(BANDS**2), atol=2e-3)


def test_the_first_bands_are_a_constant_and_y_z_x():
    directions = normalise(np.random.default_rng(0).normal(size=(50, 3)))
    values = basis(directions, 2)
    np.testing.assert_allclose(values[:, 0], math.sqrt(0.25 / math.pi))
    expected = math.sqrt(0.75 / math.pi) * directions[:, [1, 2, 0]]
    np.testing.assert_allclose(values[:, 1:], expected, atol=1e-12)


@pytest.mark.parametrize("shape", [(1, 1), (2, 3), (8, 16), (256, 512)])
def test_a_constant_has_band_zero_only(shape):
    coefficients = project(environment_from_array(np.full((*shape, 3), 0.7)), BANDS)
    np.testing.assert_allclose(coefficients[0], 0.7 * math.sqrt(4.0 * math.pi), rtol=1e-5)
    assert np.abs(coefficients[1:]).max() < 1e-5


@pytest.mark.parametrize("shape", [(1, 3), (5, 9), (12, 24)])
def test_projection_is_the_integral_of_what_lookup_gives(shape):
    environment = random_map(*shape)
    directions, weights = sphere()
    expected = basis(directions, BANDS).T @ (environment.lookup(directions) * weights[:, None])
    np.testing.assert_allclose(
        project(environment, BANDS), expected, atol=3e-3 * np.abs(environment.radiance).max()
    )


def test_projection_is_linear():
    first, second = random_map(seed=1), random_map(seed=2)
    both = environment_from_array(2.0 * first.radiance + 0.5 * second.radiance)
    expected = 2.0 * project(first, BANDS) + 0.5 * project(second, BANDS)
    np.testing.assert_allclose(project(both, BANDS), expected, rtol=1e-5, atol=1e-5)


def test_turning_about_z_turns_the_function():
    coefficients = np.random.default_rng(0).normal(size=(BANDS**2, 3))
    directions = normalise(np.random.default_rng(9).normal(size=(200, 3)))
    expected = basis(rotate_about_z(directions, -37.0), BANDS) @ coefficients
    found = basis(directions, BANDS) @ rotate_z(coefficients, 37.0)
    np.testing.assert_allclose(found, expected, atol=1e-10)


def test_projecting_a_turned_map_is_turning_the_projection():
    environment = random_map(16, 32)
    for quarter in range(4):
        rolled = environment_from_array(np.roll(environment.radiance, -8 * quarter, axis=1))
        expected = project(rolled, BANDS)
        np.testing.assert_allclose(project(environment.rotated(90.0 * quarter), BANDS), expected, atol=1e-5)
        turned = rotate_z(project(environment, BANDS), 90.0 * quarter)
        np.testing.assert_allclose(turned, expected, atol=1e-5)


def test_irradiance_of_a_constant_is_pi_times_it_and_of_a_gradient_two_thirds_pi():
    factors = cosine_factors(BANDS)
    assert factors[0] == pytest.approx(math.pi)
    assert factors[1:4] == pytest.approx(2.0 * math.pi / 3.0)
    assert factors[9:16] == pytest.approx(0.0)
    directions, weights = sphere()
    cosine = np.maximum(directions[:, 2], 0.0)
    zonal = basis(directions, BANDS).T @ (cosine * weights)
    for degree in range(BANDS):
        centre = degree * (degree + 1)
        expected = zonal[centre] * math.sqrt(4.0 * math.pi / (2 * degree + 1))
        assert factors[centre] == pytest.approx(expected, abs=1e-3)


@pytest.mark.parametrize("bands", [0, 17])
def test_what_makes_no_sense_is_refused(bands):
    with pytest.raises(SettingError):
        basis(np.eye(3), bands)
