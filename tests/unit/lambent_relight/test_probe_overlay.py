"""Balls over a picture: where they stand, what they show, and what they leave alone."""

import numpy as np
import pytest
from lambent_core.directions import normalise, pixel_directions
from lambent_relight.cameras import turntable
from lambent_relight.environment.maps import environment_from_array
from lambent_relight.environment.probes import GREY
from lambent_relight.picture import RelitPicture
from lambent_relight.probe_overlay import LightProbes


def picture(side, rgb=0.25, opacity=1.0):
    image = np.full((side, side, 3), rgb, np.float32)
    layers = ("standard_error", "direct", "indirect", "diffuse", "specular", "albedo", "normal")
    scalars = ("visibility", "perceptual_roughness", "metalness", "distance", "depth", "coverage")
    plane = np.full((side, side, 1), opacity, np.float32)
    rest = dict.fromkeys(layers, image) | dict.fromkeys(scalars, plane)
    return RelitPicture(rgb=image, opacity=plane, num_samples=0, **rest)


def lamp(direction):
    inside = pixel_directions(32, 64) @ normalise(np.asarray(direction, float)) > 0.97
    return environment_from_array(0.01 + inside[..., None] * np.ones(3))


def test_both_balls_stand_in_the_lower_left_corner_and_the_rest_stays():
    (camera,) = turntable(1, radius=3.0, width=70, height=70)
    even = LightProbes(environment_from_array(np.full((8, 16, 3), 2.0)))
    before = picture(70, opacity=0.0)
    after = even.over(before, camera)
    rows, columns = np.nonzero(after.opacity[..., 0])
    assert (rows.min(), rows.max() + 1) == (70 - 1 - 10, 69)
    assert (columns.min(), columns.max() + 1) == (1, 1 + 10 + 1 + 10)
    np.testing.assert_allclose(after.rgb[64, 6], 2.0, rtol=1e-5)
    np.testing.assert_allclose(after.rgb[64, 17], 2.0 * GREY, rtol=1e-5)
    assert after.direct is before.direct
    covered = even.over(picture(70), camera)
    assert covered.opacity.min() == 1.0
    np.testing.assert_allclose(covered.rgb[:58], 0.25)


@pytest.mark.parametrize("elevation_deg", [-30.0, 0.0, 50.0])
def test_a_lamp_behind_the_camera_is_in_the_middle_of_both_balls(elevation_deg):
    (camera,) = turntable(1, radius=3.0, elevation_deg=elevation_deg, start_deg=130.0, width=210, height=210)
    probes = LightProbes(lamp(camera.camera_to_world[:3, 2]))
    shown = probes.over(picture(210, opacity=0.0), camera)
    for left in (3, 3 + 30 + 3):
        ball = shown.rgb[210 - 3 - 30 : 207, left : left + 30].sum(axis=-1)
        bright = np.argwhere(ball > 0.9 * ball.max()).mean(axis=0)
        np.testing.assert_allclose(bright, 14.5, atol=1.5)
    # Turned away, the lamp leaves the middle of the mirror.
    turned = probes.over(picture(210, opacity=0.0), camera, rotate_deg=90.0)
    assert turned.rgb[192, 18].sum() < 0.1 * shown.rgb[192, 18].sum()


def test_a_small_picture_has_no_room_for_balls():
    (camera,) = turntable(1, radius=3.0, width=27, height=40)
    small = picture(40)
    assert LightProbes(lamp((1, 0, 0))).over(small, camera) is small
