"""Limiting the sun, and the account of what is lost."""

import numpy as np
import pytest
from lambent_core.directions import pixel_solid_angles
from lambent_core.errors import SettingError
from lambent_relight.environment.maps import environment_from_array
from lambent_relight.environment.sun_clamp import clamp_sun


def sunny():
    image = np.full((8, 16, 3), 0.5)
    image[2, 3] = (400.0, 200.0, 100.0)
    return environment_from_array(image)


def test_nothing_stays_above_the_limit_and_hues_stay():
    clamped, report = clamp_sun(sunny(), 50.0)
    np.testing.assert_allclose(clamped.radiance[2, 3], (50.0, 25.0, 12.5))
    np.testing.assert_array_equal(np.delete(clamped.radiance.reshape(-1, 3), 2 * 16 + 3, axis=0), 0.5)
    assert (report.num_texels, report.brightest) == (1, 400.0)


def test_the_report_accounts_for_the_energy():
    environment = sunny().rotated(30.0)
    clamped, report = clamp_sun(environment, 50.0)
    weights = pixel_solid_angles(8, 16)
    for values, image in ((report.energy_before, environment), (report.energy_after, clamped)):
        np.testing.assert_allclose(values, weights @ image.radiance.sum(axis=1), rtol=1e-6)
    assert report.solid_angle_sr == pytest.approx(weights[2])
    assert report.share_lost == pytest.approx(
        1 - sum(report.energy_after) / sum(report.energy_before), abs=1e-12
    )
    assert 0.9 < report.share_lost * sum(report.energy_before) / (weights[2] * 612.5) < 1.1
    assert "1 texels" in str(report)
    assert clamped.rotate_deg == 30.0


def test_a_limit_above_everything_changes_nothing():
    environment = sunny()
    clamped, report = clamp_sun(environment, 1000.0)
    assert clamped is environment
    assert report.share_lost == 0.0
    assert "nothing is above 1000" in str(report)


@pytest.mark.parametrize("limit", [0.0, -1.0, float("nan"), float("inf")])
def test_a_limit_that_is_no_positive_number_is_refused(limit):
    with pytest.raises(SettingError):
        clamp_sun(sunny(), limit)
