"""Cameras: files, turntables, rays."""

import json

import numpy as np
import pytest
from lambent_core.errors import CameraError
from lambent_relight.cameras import Camera, cameras_json, look_at, parse_cameras, turntable


def test_turntable_cameras_look_at_the_target_with_the_world_upright():
    target = np.array([0.2, -0.3, 0.5])
    cameras = turntable(6, radius=3.0, elevation_deg=30.0, target=target, width=9, height=9)
    for index, camera in enumerate(cameras):
        position = camera.camera_to_world[:3, 3]
        assert np.linalg.norm(position - target) == pytest.approx(3.0)
        assert position[2] - target[2] == pytest.approx(1.5)
        azimuth = np.degrees(np.arctan2(*(position - target)[[1, 0]])) % 360.0
        assert azimuth == pytest.approx(60.0 * index, abs=1e-9)
        origins, directions = camera.rays()
        centre = 4 * 9 + 4
        np.testing.assert_allclose(origins[centre] + 3.0 * directions[centre], target, atol=1e-5)
        assert camera.camera_to_world[2, 1] > 0.0
        np.testing.assert_allclose(np.linalg.norm(directions, axis=-1), 1.0, atol=1e-6)


def test_rays_go_right_along_a_row_and_down_along_a_column():
    camera = turntable(1, radius=3.0, elevation_deg=0.0, width=8, height=6)[0]
    directions = camera.rays()[1].reshape(6, 8, 3)
    # The camera stands on +x and looks towards -x, so that its right is +y.
    assert (np.diff(directions[..., 1], axis=1) > 0.0).all()
    assert (np.diff(directions[..., 2], axis=0) < 0.0).all()
    left, right = directions[3, 0, 1], directions[3, -1, 1]
    assert left == pytest.approx(-right)


def test_the_field_of_view_spans_the_outer_edges_of_the_pixels():
    camera = turntable(1, radius=1.0, elevation_deg=0.0, width=10, height=10, field_of_view_deg=60.0)[0]
    assert np.degrees(2 * np.arctan(5.0 / camera.focal_x)) == pytest.approx(60.0)


def test_a_resized_camera_sees_the_same_view():
    camera = turntable(1, radius=3.0, width=8, height=6)[0]
    # Three pixels for one along a row, five along a column.
    fine = camera.resized(24, 30).rays()[1].reshape(30, 24, 3)
    coarse = camera.rays()[1].reshape(6, 8, 3)
    np.testing.assert_allclose(fine[2::5, 1::3], coarse, atol=1e-6)


def test_depth_along_the_axis_is_that_of_the_points_on_the_rays():
    pose = look_at((3.0, -2.0, 1.5), (0.1, 0.2, 0.3))
    camera = Camera(
        name="off centre",
        width=7,
        height=5,
        focal_x=6.0,
        focal_y=9.0,
        centre_x=2.0,
        centre_y=4.5,
        camera_to_world=pose,
    )
    distance = np.random.default_rng(0).uniform(1.0, 5.0, (5, 7, 1))
    origin, direction = camera.rays()
    points = origin + distance.reshape(-1, 1) * direction
    expected = (points - pose[:3, 3]) @ -pose[:3, 2]
    np.testing.assert_allclose(camera.depth_along_axis(distance).ravel(), expected, rtol=1e-5)


def test_looking_straight_down_has_a_defined_roll():
    pose = look_at((0, 0, 5), (0, 0, 0))
    np.testing.assert_allclose(pose[:3, :3].T @ pose[:3, :3], np.eye(3), atol=1e-12)
    np.testing.assert_allclose(pose[:3, 1], [0, 1, 0], atol=1e-12)


def test_cameras_survive_being_written_and_read():
    cameras = turntable(3, radius=2.0, width=20, height=10)
    for before, after in zip(cameras, parse_cameras(cameras_json(cameras).encode()), strict=True):
        assert after.key() == before.key()
        assert after.name == before.name


def entry(**changes) -> bytes:
    value = json.loads(cameras_json(turntable(1, radius=2.0)))["cameras"][0] | changes
    return json.dumps({"cameras": [{k: v for k, v in value.items() if v is not None}]}).encode()


MIRRORED = np.diag([-1.0, 1.0, 1.0, 1.0]).ravel().tolist()
SCALED = np.diag([2.0, 2.0, 2.0, 1.0]).ravel().tolist()


@pytest.mark.parametrize(
    "data",
    [
        entry(width=0),
        entry(width=10.5),
        entry(height=10**6),
        entry(focal_x=-1.0),
        entry(focal_y=None),
        entry(centre_x="left"),
        entry(camera_to_world=[0.0] * 15),
        entry(camera_to_world=[float("nan")] * 16),
        entry(camera_to_world=MIRRORED),
        entry(camera_to_world=SCALED),
    ],
)
def test_impossible_cameras_are_refused_by_number(data):
    with pytest.raises(CameraError, match=r'camera\.invalid: camera 0 of "cameras\.json"'):
        parse_cameras(data)


@pytest.mark.parametrize(
    "data", [b"", b"[]", b'{"cameras": 3}', b'{"cameras": [3]}', b'{"cameras": []}', b"\xff"]
)
def test_files_without_cameras_are_refused(data):
    with pytest.raises(CameraError, match=r"camera\."):
        parse_cameras(data)


@pytest.mark.parametrize(
    "arguments",
    [{"num_views": 0}, {"radius": 0.0}, {"radius": float("nan")}, {"field_of_view_deg": 180.0}],
)
def test_impossible_turntables_are_refused(arguments):
    with pytest.raises(CameraError):
        turntable(**({"num_views": 4, "radius": 2.0} | arguments))
