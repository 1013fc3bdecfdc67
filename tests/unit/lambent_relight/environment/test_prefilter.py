"""Prefiltered levels against brute force, and what every filter of light must keep."""

import numpy as np
import pytest
from lambent_core.directions import normalise, pixel_directions, pixel_solid_angles
from lambent_core.errors import SettingError
from lambent_relight.brdf import ggx_density
from lambent_relight.environment.area_mean import area_mean
from lambent_relight.environment.harmonics import basis, cosine_factors, project
from lambent_relight.environment.maps import environment_from_array
from lambent_relight.environment.prefilter import Prefiltered, irradiance, level_width, prefilter, zonal_mean

DIRECTIONS = normalise(np.random.default_rng(1).normal(size=(300, 3)))


def smooth_map(height=16, width=32, seed=0):
    return environment_from_array(np.random.default_rng(seed).gamma(0.7, 1.0, (height, width, 3)))


def test_the_sharpest_level_is_the_map():
    environment = smooth_map()
    levels = prefilter(environment, 3)
    np.testing.assert_array_equal(levels.levels[0], environment.radiance)
    for turned in (0.0, 73.0):
        np.testing.assert_allclose(
            levels.rotated(turned).lookup(DIRECTIONS, np.zeros(300)),
            environment.rotated(turned).lookup(DIRECTIONS),
            rtol=1e-4,
            atol=1e-4,
        )


@pytest.mark.parametrize("shape", [(1, 1), (3, 5), (64, 128)])
def test_a_constant_stays_constant(shape):
    levels = prefilter(environment_from_array(np.full((*shape, 3), (0.3, 1.0, 7.0))), 4)
    for level in levels.levels:
        np.testing.assert_allclose(level, np.broadcast_to((0.3, 1.0, 7.0), level.shape), rtol=1e-6)


def test_filtering_is_linear():
    first, second = smooth_map(seed=1), smooth_map(seed=2)
    both = environment_from_array(2.0 * first.radiance + 0.5 * second.radiance)
    parts = [prefilter(one, 4).levels for one in (first, second, both)]
    for one, two, sum_of_both in zip(*parts, strict=True):
        np.testing.assert_allclose(sum_of_both, 2.0 * one + 0.5 * two, rtol=1e-5, atol=1e-6)


def test_a_level_is_the_mean_under_the_half_vector_density_times_the_cosine():
    image = np.full((64, 128, 3), 0.1)
    image[20:23, 30:34] = 30.0
    environment = environment_from_array(image)
    levels = prefilter(environment)
    fine = pixel_directions(192, 384).reshape(-1, 3)
    weights = np.repeat(pixel_solid_angles(192, 384), 384)
    radiance = environment.lookup(fine)[:, 0]
    peak = pixel_directions(64, 128)[21, 31]
    for roughness in (0.375, 0.5, 0.75, 1.0):
        for offset in ((0.0, 0.0, 0.0), (0.2, 0.1, 0.3), (0.6, -0.5, 0.4)):
            direction = normalise(peak + np.array(offset))
            cosine = fine @ direction
            half = ggx_density((1 + cosine) / 2, (1 - cosine) / 2, roughness**2)
            kernel = np.maximum(cosine, 0.0) * half * weights
            expected = (kernel * radiance).sum() / kernel.sum()
            found = levels.lookup(direction[None], np.array([roughness]))[0, 0]
            assert found == pytest.approx(expected, rel=0.03)


def test_roughness_between_levels_is_a_mix_and_is_clipped_outside():
    levels = prefilter(smooth_map(), 5)
    low, high = (levels.lookup(DIRECTIONS, np.full(300, r)) for r in (0.25, 0.5))
    mixed = levels.lookup(DIRECTIONS, np.full((300, 1), 0.3125))
    np.testing.assert_allclose(mixed, 0.75 * low + 0.25 * high, rtol=1e-4, atol=1e-5)
    for beyond, end in ((1.7, 1.0), (-0.4, 0.0)):
        np.testing.assert_array_equal(
            levels.lookup(DIRECTIONS, np.full(300, beyond)), levels.lookup(DIRECTIONS, np.full(300, end))
        )


def test_turning_the_map_by_whole_pixels_turns_every_level():
    environment = smooth_map()
    rolled = prefilter(environment_from_array(np.roll(environment.radiance, -8, axis=1)), 5)
    turned = prefilter(environment, 5).rotated(90.0)
    assert isinstance(turned, Prefiltered)
    for roughness in (0.0, 0.4, 1.0):
        rough = np.full(300, roughness)
        np.testing.assert_allclose(
            turned.lookup(DIRECTIONS, rough), rolled.lookup(DIRECTIONS, rough), rtol=2e-3, atol=1e-3
        )


def test_a_convolution_keeps_the_total_and_mirrors_with_its_map():
    source = smooth_map(32, 64).radiance.astype(np.float64)

    def kernel(cosine):
        return np.exp(4.0 * (cosine - 1.0))

    mean = zonal_mean(source, kernel)
    weights = pixel_solid_angles(32, 64)[:, None, None]
    np.testing.assert_allclose((mean * weights).sum((0, 1)), (source * weights).sum((0, 1)), rtol=5e-3)
    np.testing.assert_allclose(zonal_mean(source[::-1], kernel)[::-1], mean, rtol=1e-9)
    np.testing.assert_allclose(zonal_mean(source[:, ::-1], kernel)[:, ::-1], mean, rtol=1e-9)


def test_irradiance_agrees_with_spherical_harmonics():
    environment = smooth_map(32, 64)
    directions = pixel_directions(32, 64)
    coefficients = project(environment, 9) * cosine_factors(9)[:, None] / np.pi
    expected = (basis(directions.reshape(-1, 3), 9) @ coefficients).reshape(32, 64, 3)
    np.testing.assert_allclose(irradiance(environment), expected, rtol=0.02)


def test_a_smaller_map_keeps_the_energy_whatever_its_size():
    image = np.random.default_rng(0).random((30, 50, 3))
    before = pixel_solid_angles(30, 50) @ image.sum(axis=1)
    for height, width in ((15, 25), (8, 16), (30, 50), (7, 49), (1, 1)):
        smaller = area_mean(image, height, width)
        after = pixel_solid_angles(height, width) @ smaller.sum(axis=1)
        np.testing.assert_allclose(after, before, rtol=1e-12)
    np.testing.assert_allclose(area_mean(image, 30, 50), image, atol=1e-12)
    np.testing.assert_allclose(area_mean(np.full((30, 50, 3), 2.5), 7, 11), 2.5, rtol=1e-12)


def test_levels_are_as_large_as_their_lobe_needs():
    assert [level_width((k / 8) ** 2) for k in range(1, 9)] == [512, 256, 128, 64, 64, 64, 64, 64]
    for count in (1, 17):
        with pytest.raises(SettingError):
            prefilter(smooth_map(), count)
