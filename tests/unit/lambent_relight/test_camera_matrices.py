"""The matrices in the header of an EXR project points to where they are in the picture."""

import numpy as np
import OpenEXR
import pytest
from lambent_relight import Renderer, load_bundle, turntable, write_picture_exr
from lambent_relight.cameras import Camera
from support.analytic_bundle import write_analytic_bundle
from support.analytic_scene import AnalyticScene, Sphere

TURNED = Camera(
    name="off-centre",
    width=40,
    height=30,
    focal_x=50.0,
    focal_y=45.0,
    centre_x=17.0,
    centre_y=16.5,
    camera_to_world=turntable(7, radius=3.0, elevation_deg=35.0, width=40, height=30)[3].camera_to_world,
)


def points_on_rays(camera, distance):
    """Return the points [height, width, 3] at a distance along the ray of every pixel."""
    origins, directions = camera.rays()
    shape = (camera.height, camera.width, 3)
    return origins.reshape(shape).astype(np.float64) + distance * directions.reshape(shape)


@pytest.mark.parametrize("distance", [0.7, 3.0, 40.0])
def test_a_point_on_the_ray_of_a_pixel_is_projected_to_its_centre(distance):
    matrix = TURNED.exr_attributes()["worldToNDC"].astype(np.float64)
    points = points_on_rays(TURNED, distance)
    projected = np.concatenate([points, np.ones((30, 40, 1))], axis=-1) @ matrix
    places = projected[..., :2] / projected[..., 3:] * [40.0, 30.0]
    rows, columns = np.mgrid[:30, :40]
    np.testing.assert_allclose(places, np.stack([columns, rows], axis=-1) + 0.5, atol=1e-3)


def test_camera_space_is_left_handed_with_z_forward():
    matrix = TURNED.exr_attributes()["worldToCamera"].astype(np.float64)
    pose = TURNED.camera_to_world
    right, up, back, place = pose[:3, 0], pose[:3, 1], pose[:3, 2], pose[:3, 3]
    for point, expected in (
        (place, [0.0, 0.0, 0.0]),
        (place + right, [1.0, 0.0, 0.0]),
        (place + up, [0.0, 1.0, 0.0]),
        (place - 2.0 * back, [0.0, 0.0, 2.0]),
    ):
        np.testing.assert_allclose(np.append(point, 1.0) @ matrix, [*expected, 1.0], atol=1e-5)
    assert np.linalg.det(matrix) == pytest.approx(-1.0, abs=1e-5)


def test_the_last_number_of_a_projected_point_is_its_depth():
    matrices = TURNED.exr_attributes()
    point = np.append(points_on_rays(TURNED, 2.0)[4, 5], 1.0)
    depth = (point @ matrices["worldToCamera"])[2]
    assert (point @ matrices["worldToNDC"])[3] == pytest.approx(depth, rel=1e-5)
    assert abs(np.linalg.det(matrices["worldToNDC"].astype(np.float64))) > 1e-3


def test_a_rendered_file_has_the_matrices_of_its_camera_and_visibility_is_a_share(tmp_path):
    """Few directions, whose estimate of a share is often above one."""
    scene = AnalyticScene([Sphere((0.0, 0.0, 0.0), 1.0), Sphere((0.0, 0.0, 1.6), 0.5)])
    renderer = Renderer(load_bundle(write_analytic_bundle(tmp_path / "ball", scene)), num_threads=1)
    picture = renderer.render(TURNED, np.ones((4, 8, 3), np.float32), spp=2, antialias=1, background="white")
    write_picture_exr(tmp_path / "p.exr", picture)
    header = OpenEXR.File(str(tmp_path / "p.exr"), separate_channels=True).parts[0].header
    for name, expected in TURNED.exr_attributes().items():
        np.testing.assert_array_equal(header[name], expected)
    assert picture.visibility.min() >= 0.0
    assert picture.visibility.max() <= 1.0
