"""Pictures keep their light and their directions whatever size or lens they had."""

import numpy as np
import pytest
from lambent_capture.pictures.lens import LensFigures, camera_with_lens
from lambent_capture.pictures.resample import (
    area_weights,
    averaged,
    reduced_size,
    resampled,
    resampled_colour,
    resampled_weighted,
)
from lambent_capture.problems import Problems
from lambent_proto.v1 import scene_pb2

BARREL = (-0.25, 0.08, 0.002, -0.001)


def test_area_weights_average_and_cover_every_source_pixel_equally():
    weights = area_weights(128, 50)
    np.testing.assert_allclose(weights.sum(axis=1), 1.0)
    np.testing.assert_allclose(weights.sum(axis=0), 50 / 128)


def test_a_picture_is_reduced_and_enlarged_by_means_over_areas():
    image = np.arange(8 * 16 * 3, dtype=np.float32).reshape(8, 16, 3)
    small = averaged(image, (8, 4))
    np.testing.assert_allclose(small[0, 0], image[:2, :2].mean(axis=(0, 1)))
    np.testing.assert_allclose(averaged(image, (32, 16))[4:6, 6:8].mean(axis=(0, 1)), image[2, 3])
    assert averaged(image, (12, 6)).mean() == pytest.approx(image.mean(), rel=1e-5)


@pytest.mark.parametrize(
    ("size", "side", "expected"),
    [((800, 400), 128, (128, 64)), ((64, 48), 128, (64, 48)), ((3, 900), 9, (1, 9))],
)
def test_pictures_are_reduced_but_never_enlarged(size, side, expected):
    assert reduced_size(*size, side) == expected


def pinhole(width, height):
    return scene_pb2.Camera(
        width=width, height=height, focal_x=50.0, focal_y=50.0, centre_x=1.0, centre_y=1.0
    )


def test_reducing_weighs_colour_by_coverage():
    values = np.zeros((4, 4, 4), dtype=np.float32)
    values[::2] = [1.0, 0.0, 0.0, 1.0]
    values[1::2] = [0.0, 9.0, 0.0, 0.0]
    expected = np.broadcast_to(np.float32([1.0, 0.0, 0.0, 0.5]), (2, 2, 4))
    np.testing.assert_allclose(resampled_colour(values, pinhole(4, 4), (2, 2)), expected)


def test_reducing_one_channel_ignores_what_has_no_weight():
    values = np.float32([[[3.0], [100.0]]])
    weight = np.float32([[[1.0], [0.0]]])
    np.testing.assert_allclose(resampled_weighted(values, weight, pinhole(2, 1), (1, 1)), [[[3.0]]])


def barrel_camera(width=400, height=300, distortion=BARREL):
    figures = LensFigures(
        width=width,
        height=height,
        focal_x=350.0,
        focal_y=340.0,
        centre_x=0.52 * width,
        centre_y=0.48 * height,
        distortion=distortion,
    )
    return camera_with_lens(figures, np.eye(4), "a", Problems())


def stripes(x, y):
    """Return a smooth picture on the plane at depth 1: what is seen depends on the direction only."""
    return np.stack([0.5 + 0.4 * np.sin(9.0 * x), 0.5 + 0.4 * np.cos(7.0 * y), x + 2.0], axis=-1)


def invert(camera, u, v):
    """Return pinhole coordinates of points of the distorted picture by fixed-point iteration."""
    from lambent_capture.pictures.lens import distorted

    lens = camera.lens
    target_x, target_y = (u - lens.centre_x) / lens.focal_x, (v - lens.centre_y) / lens.focal_y
    x, y = target_x.copy(), target_y.copy()
    for _ in range(100):
        seen_x, seen_y = distorted(x, y, np.array(lens.distortion))
        x, y = x + 0.7 * (target_x - seen_x), y + 0.7 * (target_y - seen_y)
    return x, y


@pytest.mark.parametrize("size", [(400, 300), (100, 75)])
def test_a_distorted_picture_becomes_what_the_pinhole_sees(size):
    camera = barrel_camera()
    u, v = np.meshgrid(np.arange(400) + 0.5, np.arange(300) + 0.5)
    photograph = stripes(*invert(camera, u, v)).astype(np.float32)
    straight = resampled(photograph, camera, size)
    scale = 400 / size[0]
    u, v = np.meshgrid((np.arange(size[0]) + 0.5) * scale, (np.arange(size[1]) + 0.5) * scale)
    expected = stripes((u - camera.centre_x) / camera.focal_x, (v - camera.centre_y) / camera.focal_y)
    np.testing.assert_allclose(straight, expected, atol=2e-3 * scale)


def test_undoing_distortion_keeps_the_colour_of_an_edge_free_of_what_is_behind_it():
    camera = barrel_camera()
    values = np.zeros((300, 400, 4), dtype=np.float32)
    values[:, :200] = [0.2, 0.4, 0.6, 1.0]
    values[:, 200:] = [50.0, 50.0, 50.0, 0.0]
    result = resampled_colour(values, camera, (400, 300))
    seen = result[..., 3] > 1e-3
    np.testing.assert_allclose(
        result[seen][:, :3], np.broadcast_to([0.2, 0.4, 0.6], (seen.sum(), 3)), atol=1e-3
    )
    assert ((result[..., 3] > 0.01) & (result[..., 3] < 0.99)).any()
