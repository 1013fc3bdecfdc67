"""One photograph: what it shows, in which colours, and where."""

from dataclasses import fields

import numpy as np
import pytest
from lambent_asset.mesh.mesh import Mesh
from lambent_asset.textures.photo_view import SOLID, Photograph
from lambent_core.scene import Camera, View
from lambent_relight.cameras import turntable
from support.atlas_box import SIZES, atlas_box

SIDE = 64
BOX = atlas_box()
MESH = Mesh(BOX.vertices, BOX.faces, 0.02)
(POSE,) = turntable(1, radius=6.0, elevation_deg=0.0, width=SIDE, height=SIDE)
CAMERA = Camera(**{field.name: getattr(POSE, field.name) for field in fields(Camera)})


def photograph(image, **clipped):
    view = View(name="a", camera=CAMERA, images={"day": image.astype(np.float32)}, clipped=clipped)
    return Photograph(view, "day")


def picture(rgb=(0.25, 1.5, 3.0), alpha=1.0):
    image = np.empty((SIDE, SIDE, 4), np.float32)
    image[..., :3], image[..., 3] = rgb, alpha
    return image


def facing():
    """Return points on the side of the box that faces the camera, and the normal there."""
    towards = CAMERA.position / np.linalg.norm(CAMERA.position)
    axis = int(np.abs(towards).argmax())
    points = np.random.default_rng(0).uniform(-0.3, 0.3, (50, 3)) * SIZES
    points[:, axis] = np.sign(towards[axis]) * SIZES[axis] / 2.0
    normal = np.zeros(3)
    normal[axis] = np.sign(towards[axis])
    return points.astype(np.float32), np.broadcast_to(normal, points.shape).astype(np.float32)


@pytest.mark.parametrize("alpha", [1.0, 0.99, 0.5])
@pytest.mark.parametrize("pixels", [1.0, 2.9, 8.0])
def test_colours_are_linear_radiance_that_no_alpha_is_multiplied_into(alpha, pixels):
    level = photograph(picture(alpha=alpha)).reduced(pixels)
    places = np.random.default_rng(1).uniform(8.0, SIDE - 8.0, (20, 2)).astype(np.float32)
    for found in (level.at(places), level.sharp_at(places)):
        np.testing.assert_allclose(found, np.broadcast_to([0.25, 1.5, 3.0], found.shape), rtol=1e-5)


def test_means_are_of_radiance_and_not_of_encoded_levels():
    image = picture()
    image[::2, :, :3], image[1::2, :, :3] = 0.0, 2.0
    level = photograph(image).reduced(2.0)
    assert level.factor == 2
    np.testing.assert_allclose(level.image, 1.0, rtol=1e-6)


def test_the_centre_of_the_first_pixel_is_at_one_half():
    image = picture((0.0, 0.0, 0.0))
    image[7, 3, :3] = 1.0
    level = photograph(image).reduced(1.0)
    np.testing.assert_allclose(level.at(np.float32([[3.5, 7.5]])), 1.0, atol=1e-6)
    np.testing.assert_allclose(level.at(np.float32([[4.0, 7.5]])), 0.5, atol=1e-6)


def test_only_what_is_opaque_and_not_clipped_is_seen():
    points, normals = facing()
    assert photograph(picture()).see(points, normals, MESH).visible.all()
    assert not photograph(picture(alpha=SOLID - 0.01)).see(points, normals, MESH).visible.any()
    flags = np.ones((SIDE, SIDE, 3), bool)
    assert not photograph(picture(), day=flags).see(points, normals, MESH).visible.any()
    assert not photograph(picture()).see(points, -normals, MESH).visible.any()


@pytest.mark.parametrize("channel", range(3))
def test_a_pixel_that_is_clipped_in_one_channel_is_not_seen(channel):
    """Its colour is wrong, whichever channel it was."""
    points, normals = facing()
    flags = np.zeros((SIDE, SIDE, 3), bool)
    flags[..., channel] = True
    assert not photograph(picture(), day=flags).see(points, normals, MESH).visible.any()


def test_resolution_is_pixels_for_a_scene_unit():
    points, normals = facing()
    found = photograph(picture()).see(points, normals, MESH)
    distance = np.linalg.norm(CAMERA.position - points, axis=1)
    cosine = (found.omega_o * normals).sum(axis=1)
    np.testing.assert_allclose(found.resolution, CAMERA.focal_x / distance * cosine, rtol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(found.omega_o, axis=1), 1.0, rtol=1e-5)


def test_a_light_without_a_picture_is_a_key_error():
    with pytest.raises(KeyError):
        Photograph(View(name="a", camera=CAMERA, images={"day": picture()}), "night")
