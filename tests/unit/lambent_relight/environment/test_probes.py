"""Chrome and grey balls: which way they face, and how bright they are."""

import numpy as np
import pytest
from lambent_core.directions import normalise, pixel_directions
from lambent_core.errors import SettingError
from lambent_relight.environment.maps import environment_from_array
from lambent_relight.environment.probes import GREY, chrome_ball, grey_ball, upright_map


def lamp(direction, width=0.97):
    inside = pixel_directions(32, 64) @ normalise(np.asarray(direction, float)) > width
    return environment_from_array(0.01 + inside[..., None] * np.ones(3))


def brightest(ball):
    row, column = np.unravel_index(np.argmax(ball.rgb.sum(axis=-1)), ball.rgb.shape[:2])
    size = len(ball.rgb)
    return (column + 0.5) / size * 2 - 1, 1 - (row + 0.5) / size * 2


@pytest.mark.parametrize(
    ("direction", "right", "up"),
    [
        ((1, 0, 0), 0.0, 0.0),
        ((0, 1, 0), 0.7, 0.0),
        ((0, -1, 0), -0.7, 0.0),
        ((0, 0, 1), 0.0, 0.7),
        ((0, 0, -1), 0.0, -0.7),
    ],
)
def test_a_chrome_ball_seen_from_plus_x_shows_lights_at_half_their_angle(direction, right, up):
    assert brightest(chrome_ball(lamp(direction, 0.99), 64)) == pytest.approx((right, up), abs=0.12)


def test_a_grey_ball_is_brightest_towards_the_light_and_follows_the_rotation():
    assert brightest(grey_ball(lamp((0, 0.7, 0.7)), 48)) == pytest.approx((0.7, 0.7), abs=0.12)
    turned = lamp((1, 0, 0)).rotated(60.0)
    assert brightest(grey_ball(turned, 48)) == pytest.approx((np.sin(np.pi / 3), 0.0), abs=0.12)
    assert brightest(grey_ball(turned, 48, from_deg=60.0)) == pytest.approx((0.0, 0.0), abs=0.15)


def test_under_even_light_chrome_is_white_and_grey_is_eighteen_per_cent():
    even = environment_from_array(np.full((8, 16, 3), 2.0))
    chrome, grey = chrome_ball(even, 16), grey_ball(even, 16)
    inside = chrome.opacity[..., 0] > 0.0
    np.testing.assert_allclose(chrome.rgb[inside], 2.0, rtol=1e-5)
    np.testing.assert_allclose(grey.rgb[inside], 2.0 * GREY, rtol=1e-5)
    assert chrome.opacity.mean() == pytest.approx(np.pi / 4, abs=0.02)
    assert chrome.rgb[~inside].max() == 0.0


def test_the_upright_map_applies_the_rotation():
    environment = environment_from_array(np.random.default_rng(0).random((8, 16, 3)))
    np.testing.assert_allclose(
        upright_map(environment.rotated(90.0), 8), np.roll(environment.radiance, -4, axis=1), atol=1e-5
    )


def test_a_size_out_of_range_is_refused():
    with pytest.raises(SettingError):
        chrome_ball(lamp((1, 0, 0)), 1)
