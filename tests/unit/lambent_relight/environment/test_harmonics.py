"""Spherical harmonics against quadrature, and the symmetries they promise."""

import math

import numpy as np
import pytest
from lambent_relight.directions import normalise, pixel_directions, pixel_solid_angles, rotate_about_z
from lambent_relight.environment.harmonics import (
    basis,
    cosine_factors,
    evaluate,
    project,
    rotate_z,
    rotation,
    window,
)
from lambent_relight.environment.maps import environment_from_array
from lambent_relight.errors import SettingError

BANDS = 7


def random_map(height=12, width=24, seed=0):
    return environment_from_array(np.random.default_rng(seed).gamma(0.5, 2.0, (height, width, 3)))


def random_rotation(seed):
    q, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return q * np.sign(np.linalg.det(q))


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


@pytest.mark.parametrize("seed", range(4))
def test_a_rotation_turns_the_function(seed):
    matrix = random_rotation(seed)
    coefficients = np.random.default_rng(seed).normal(size=(BANDS**2, 3))
    directions = normalise(np.random.default_rng(9).normal(size=(200, 3)))
    turned = rotation(BANDS, matrix).apply(coefficients)
    np.testing.assert_allclose(
        evaluate(turned, directions), evaluate(coefficients, directions @ matrix), atol=1e-10
    )


def test_a_rotation_keeps_the_energy_of_every_band():
    for degree, block in enumerate(rotation(BANDS, random_rotation(7)).blocks):
        np.testing.assert_allclose(block @ block.T, np.eye(2 * degree + 1), atol=1e-10)


def test_rotations_after_each_other_are_one_rotation():
    first, second = random_rotation(1), random_rotation(2)
    coefficients = np.random.default_rng(3).normal(size=(BANDS**2, 3))
    stepwise = rotation(BANDS, second).apply(rotation(BANDS, first).apply(coefficients))
    np.testing.assert_allclose(rotation(BANDS, second @ first).apply(coefficients), stepwise, atol=1e-10)


def test_projecting_a_turned_map_is_turning_the_projection():
    environment = random_map(16, 32)
    for quarter in range(4):
        rolled = environment_from_array(np.roll(environment.radiance, -8 * quarter, axis=1))
        expected = project(rolled, BANDS)
        np.testing.assert_allclose(project(environment.rotated(90.0 * quarter), BANDS), expected, atol=1e-5)
        angle = math.radians(90.0 * quarter)
        matrix = [
            [math.cos(angle), -math.sin(angle), 0.0],
            [math.sin(angle), math.cos(angle), 0.0],
            [0.0, 0.0, 1.0],
        ]
        turned = rotation(BANDS, np.array(matrix)).apply(project(environment, BANDS))
        np.testing.assert_allclose(turned, expected, atol=1e-5)


def test_turning_about_z_is_the_general_rotation():
    coefficients = np.random.default_rng(0).normal(size=(BANDS**2, 3))
    matrix = rotate_about_z(np.eye(3), 37.0).T
    np.testing.assert_allclose(
        rotate_z(coefficients, 37.0), rotation(BANDS, matrix).apply(coefficients), atol=1e-10
    )


def test_projecting_a_map_turned_any_way_is_turning_the_projection():
    # A function of six bands, sampled finely, turned in between.
    coefficients = np.random.default_rng(5).normal(size=(36, 3))
    matrix = random_rotation(11)
    directions = pixel_directions(128, 256).reshape(-1, 3)
    shift = 40.0
    maps = [
        environment_from_array((shift + evaluate(coefficients, d)).reshape(128, 256, 3))
        for d in (directions, directions @ matrix)
    ]
    straight, turned = (project(one, 6) for one in maps)
    expected = rotation(6, matrix).apply(straight)
    np.testing.assert_allclose(turned, expected, atol=8e-3)


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


def test_the_window_is_one_at_band_zero_falls_and_takes_ringing_away():
    factors = window(BANDS, 7.0)
    by_band = factors[[degree * (degree + 1) for degree in range(BANDS)]]
    assert by_band[0] == 1.0
    assert (np.diff(by_band) < 0.0).all()
    np.testing.assert_array_equal(window(BANDS, math.inf), 1.0)
    assert window(BANDS, 3.0)[9:].max() == 0.0
    sun = np.zeros((32, 64, 3))
    sun[4, 7] = 1000.0
    coefficients = project(environment_from_array(sun), BANDS)
    directions, _ = sphere(32)
    plain = evaluate(coefficients, directions)
    windowed = evaluate(coefficients * factors[:, None], directions)
    assert windowed.min() > 0.2 * plain.min()


@pytest.mark.parametrize(
    "call",
    [
        lambda: basis(np.eye(3), 0),
        lambda: basis(np.eye(3), 17),
        lambda: rotation(3, np.diag([1.0, 1.0, -1.0])),
        lambda: rotation(3, 2.0 * np.eye(3)),
        lambda: window(3, 0.0),
    ],
)
def test_what_makes_no_sense_is_refused(call):
    with pytest.raises(SettingError):
        call()
