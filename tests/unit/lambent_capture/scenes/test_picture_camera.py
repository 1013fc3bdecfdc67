"""Cameras of picture files: they agree with the scene's pinholes, and with OpenCV's lens model."""

import numpy as np
import pytest
from lambent_capture.scenes.picture_camera import PictureCamera
from lambent_proto.v1 import scene_pb2
from support.captures import look_at

POSE = look_at(np.array([3.0, 1.0, 2.0]))
POINTS = np.random.default_rng(0).uniform(-0.5, 0.5, (50, 3))


def pinhole(**changes) -> PictureCamera:
    values = {
        "width": 64,
        "height": 48,
        "focal": (80.0, 82.0),
        "centre": (33.0, 22.0),
        "camera_to_world": POSE,
    }
    return PictureCamera(**{**values, **changes})


def test_the_point_that_is_looked_at_is_seen_at_the_optical_axis():
    column, row, depth = pinhole().project(np.zeros((1, 3)))
    assert [column[0], row[0]] == pytest.approx([33.0, 22.0])
    assert depth[0] == pytest.approx(np.sqrt(14.0))


def test_up_in_the_world_is_up_in_the_picture():
    _, rows, _ = pinhole().project(np.array([[0.0, 0.0, 0.3], [0.0, 0.0, -0.3]]))
    assert rows[0] < 22.0 < rows[1]


def test_a_resized_camera_sees_the_same_share_of_the_picture():
    small = pinhole().resized(32, 16)
    for ours, theirs, size, other in zip(
        pinhole().project(POINTS)[:2], small.project(POINTS)[:2], (64, 48), (32, 16), strict=True
    ):
        np.testing.assert_allclose(ours / size, theirs / other)


def test_points_behind_the_camera_are_not_shown():
    behind = POSE[:3, 3] + POSE[:3, 2]
    shown, index, depth = pinhole().pixels(np.array([behind, [0.0, 0.0, 0.0], [9.0, 9.0, 9.0]]))
    assert depth[0] < 0.0
    assert shown.tolist() == [False, True, False]
    assert index.tolist() == [0, 22 * 64 + 33, 0]


def test_distortion_is_opencv_s_model():
    k1, k2, p1, p2, k3 = 0.1, -0.05, 0.01, -0.02, 0.03
    x, y = (p - c for p, c in zip(pinhole().project(POINTS)[:2], (33.0, 22.0), strict=True))
    x, y = x / 80.0, y / 82.0
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    expected_x = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    expected_y = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    column, row, _ = pinhole(distortion=(k1, k2, p1, p2, k3)).project(POINTS)
    np.testing.assert_allclose(column, 33.0 + 80.0 * expected_x)
    np.testing.assert_allclose(row, 22.0 + 82.0 * expected_y)


def test_points_far_outside_do_not_fold_back_into_a_barrel_picture():
    # With k1 = -0.2 the distorted radius falls beyond r = 1.29, and r = 1.9 would land inside the picture.
    side = POSE[:3, :3] @ np.array([1.9, 0.0, -1.0]) + POSE[:3, 3]
    assert pinhole(width=200, height=200).pixels(side[None])[0].tolist() == [True]
    shown, _, _ = pinhole(width=200, height=200, distortion=(-0.2,)).pixels(side[None])
    assert shown.tolist() == [False]


def test_the_camera_of_a_frame_is_that_of_its_files():
    frame = scene_pb2.Frame(
        camera=scene_pb2.Camera(
            width=64,
            height=48,
            focal_x=80,
            focal_y=82,
            centre_x=33,
            centre_y=22,
            camera_to_world=POSE.ravel(),
        )
    )
    assert PictureCamera.of_frame(frame).focal == (80.0, 82.0)
    frame.camera.lens.CopyFrom(
        scene_pb2.Lens(
            width=70, height=50, focal_x=90, focal_y=91, centre_x=35, centre_y=25, distortion=[0.1]
        )
    )
    taken = PictureCamera.of_frame(frame)
    assert (taken.width, taken.focal, taken.distortion) == (70, (90.0, 91.0), (0.1,))


def test_pixels_per_unit_fall_with_the_distance():
    assert pinhole().pixels_per_unit(np.zeros(3)) == pytest.approx(82.0 / np.sqrt(14.0))
    assert pinhole().pixels_per_unit(POSE[:3, 3] + POSE[:3, 2]) == 0.0
