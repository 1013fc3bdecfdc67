"""Bright peaks as lights: where they are, what they carry, and that nothing is lost."""

from dataclasses import replace

import numpy as np
import pytest
from lambent_core.directions import normalise, pixel_directions
from lambent_core.errors import SettingError
from lambent_relight.environment.dominant_lights import energy, split
from lambent_relight.environment.maps import environment_from_array


def sky_with(suns, height=64, width=128):
    """Return a map with a gradient and discs of 2 degrees: (direction, radiance)."""
    directions = pixel_directions(height, width)
    image = 0.3 + 0.2 * directions[..., 2:] * np.ones(3)
    for direction, radiance in suns:
        inside = directions @ normalise(np.asarray(direction, float)) > np.cos(np.radians(3.0))
        image = image + inside[..., None] * np.asarray(radiance)
    return environment_from_array(image)


SUNS = [((1.0, 0.5, 0.6), (900.0, 700.0, 400.0)), ((-0.3, -1.0, 0.2), (100.0, 200.0, 300.0))]


def test_suns_are_found_brightest_first_with_their_colour():
    lights = split(sky_with(SUNS), 4)
    assert len(lights.directions) == 2
    for found, flux, (direction, radiance) in zip(
        lights.directions, lights.radiance_solid_angle, SUNS, strict=True
    ):
        assert found @ normalise(np.asarray(direction)) > np.cos(np.radians(1.0))
        np.testing.assert_allclose(flux / flux.sum(), np.array(radiance) / sum(radiance), atol=1e-3)
    assert lights.residual.radiance.max() < 1.0


def test_radii_are_those_of_discs_in_the_map_however_it_is_turned():
    # 3 degrees, of pixels of 0.7.
    environment = sky_with(SUNS, 256, 512)
    for turned in (environment, replace(environment, rotate_deg=70.0)):
        np.testing.assert_allclose(np.degrees(split(turned, 4).radii_rad), 3.0, rtol=0.05)
    assert split(sky_with([]), 4).radii_rad.shape == (0,)


@pytest.mark.parametrize("count", [0, 1, 2, 8])
@pytest.mark.parametrize("seed", range(3))
def test_energy_is_kept_whatever_the_map(count, seed):
    image = np.random.default_rng(seed).gamma(0.05, 5.0, (20, 40, 3))
    environment = environment_from_array(image)
    lights = split(environment, count)
    together = energy(lights.residual.radiance) + lights.radiance_solid_angle.sum(axis=0)
    np.testing.assert_allclose(together, energy(environment.radiance), rtol=1e-6)
    assert lights.residual.radiance.min() >= 0.0
    assert len(lights.directions) <= count


def test_a_turned_environment_has_turned_lights_and_the_same_residual():
    environment = sky_with(SUNS)
    straight, turned = split(environment, 2), split(environment.rotated(90.0), 2)
    expected = straight.directions[:, [1, 0, 2]] * [-1.0, 1.0, 1.0]
    np.testing.assert_allclose(turned.directions, expected, atol=1e-6)
    np.testing.assert_array_equal(turned.residual.radiance, straight.residual.radiance)
    assert turned.residual.rotate_deg == 90.0


@pytest.mark.parametrize(
    "direction", [(0.0, 0.0, 1.0), (0.02, 0.0, -1.0), (-1.0, 1e-3, 0.0), (-1.0, -1e-3, 0.3)]
)
def test_suns_at_the_poles_and_on_the_seam_are_whole(direction):
    lights = split(sky_with([(direction, (500.0, 500.0, 500.0))]), 3)
    assert len(lights.directions) == 1
    assert lights.directions[0] @ normalise(np.asarray(direction)) > np.cos(np.radians(1.5))


def test_even_and_black_maps_have_no_lights():
    for value in (0.0, 1.0):
        lights = split(environment_from_array(np.full((16, 32, 3), value)), 4)
        assert lights.directions.shape == lights.radiance_solid_angle.shape == (0, 3)
        np.testing.assert_array_equal(lights.residual.radiance, np.float32(value))
    assert len(split(environment_from_array(np.ones((1, 1, 3))), 4).directions) == 0


def test_a_light_of_little_energy_stays_in_the_map():
    assert len(split(sky_with([SUNS[0], ((0.0, 1.0, 0.0), (3.0, 3.0, 3.0))]), 4).directions) == 1


def test_more_lights_than_there_may_be_are_refused():
    with pytest.raises(SettingError):
        split(sky_with([]), 9)
