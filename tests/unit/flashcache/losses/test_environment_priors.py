import math

import pytest
import torch
from flashcache.errors import ConfigError
from flashcache.geometry.directions import environment_directions, environment_solid_angles
from flashcache.losses.environment import (
    EnvironmentPriorConfig,
    grey_prior,
    row_weights,
    variation_prior,
    white_prior,
)


def test_grey_light_costs_nothing_and_coloured_light_does():
    grey = torch.rand(50, 1).expand(-1, 3)
    assert float(grey_prior(grey)) == pytest.approx(0.0, abs=1e-7)
    assert float(grey_prior(grey * torch.tensor([1.0, 0.5, 0.5]))) > 0.05


def test_a_row_counts_by_its_solid_angle():
    weights = row_weights(8, pole_aware=True, like=torch.zeros(1))[:, 0]
    angles = environment_solid_angles(8, 16)
    torch.testing.assert_close(weights, angles / angles.mean())
    assert (row_weights(8, pole_aware=False, like=torch.zeros(1)) == 1.0).all()


def test_colours_that_cancel_over_the_sphere_are_white_in_total():
    image = torch.ones(8, 16, 3)
    image[:, :8] *= torch.tensor([1.5, 1.0, 0.5])
    image[:, 8:] *= torch.tensor([0.5, 1.0, 1.5])
    assert float(white_prior(image, pole_aware=True)) == pytest.approx(0.0, abs=1e-6)
    assert float(grey_prior(image.reshape(-1, 3))) > 0.3


def test_the_white_prior_does_not_change_with_the_scale_of_the_light():
    image = torch.rand(8, 16, 3)
    torch.testing.assert_close(white_prior(image, pole_aware=True), white_prior(7.0 * image, pole_aware=True))


def test_a_coloured_pole_hardly_counts_when_pixels_count_by_solid_angle():
    image = torch.ones(16, 32, 3)
    image[0] = torch.tensor([3.0, 1.0, 1.0])
    aware, flat = (float(white_prior(image, pole_aware=flag)) for flag in (True, False))
    assert aware < 0.2 * flat


@pytest.mark.parametrize(
    ("axis", "slope"), [(0, 3.0 / math.pi), (1, 3.0 / math.pi), (2, math.pi / 4.0)], ids=["x", "y", "z"]
)
def test_the_variation_of_a_slope_is_its_mean_over_the_sphere(axis, slope):
    # Around and along the meridians: 2/pi and 1/pi for x and y, 0 and pi/4 for z.
    directions = environment_directions(64, 128)
    image = (1.0 + 0.1 * directions[..., axis : axis + 1]).expand(-1, -1, 3)
    assert float(variation_prior(image, pole_aware=True)) == pytest.approx(0.1 * slope, rel=0.02)


def test_without_solid_angles_a_cap_on_the_pole_costs_more_than_its_rim_on_the_sphere():
    image = torch.ones(16, 32, 3)
    image[0] = 2.0
    aware, flat = (float(variation_prior(image, pole_aware=flag)) for flag in (True, False))
    assert aware < 0.5 * flat
    assert float(variation_prior(torch.ones(16, 32, 3), pole_aware=True)) == 0.0


def test_a_picture_of_one_row_is_refused():
    with pytest.raises(ConfigError, match="rows"):
        EnvironmentPriorConfig(rows=1)
