"""The light's place in every photograph follows from what it stands still with."""

import numpy as np
import pytest
from lambent_capture.loading.light_turns import adopt_light, as_light_fixed_to, fix_light, light_turn
from lambent_capture.scenes.world import move
from lambent_core.errors import UsageError
from lambent_proto.v1 import scene_pb2
from support.turning_light import about

UP = (0.0, 0.0, 1.0)


def camera(azimuth: float, elevation: float, roll: float = 0.0) -> np.ndarray:
    """Return the rotation from camera axes to the world of a camera that looks at the origin; degrees."""
    level = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])  # From +x, z up.
    return about(UP, azimuth) @ about((0.0, -1.0, 0.0), elevation) @ level @ about(UP, roll)


def manifest(*rotations: np.ndarray, fixed_to: str = "camera") -> scene_pb2.SceneManifest:
    made = scene_pb2.SceneManifest(contraction_radius=1.0)
    for number, rotation in enumerate(rotations):
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = rotation, 4.0 * rotation[:, 2]
        frame = made.frames.add(name=f"v{number}", split=scene_pb2.SPLIT_TRAIN)
        frame.camera.camera_to_world.extend(pose.ravel().tolist())
    made.frames[0].split = scene_pb2.SPLIT_TEST
    fix_light(made, fixed_to)
    return made


def turns(made: scene_pb2.SceneManifest) -> list[np.ndarray]:
    return [light_turn(made, frame) for frame in made.frames]


def test_fixed_to_the_camera_a_lamp_keeps_its_place_in_the_picture():
    cameras = [camera(200.0, 10.0), camera(10.0, 30.0), camera(80.0, -20.0, roll=15.0), camera(170.0, 60.0)]
    lamp = np.array([0.3, 0.5, 0.8])  # In camera axes.
    found = turns(manifest(*cameras))
    for rotation, turn in zip(cameras, found, strict=True):
        np.testing.assert_allclose(turn @ (rotation @ lamp), cameras[1] @ lamp, atol=1e-12)
    np.testing.assert_allclose(found[1], np.eye(3), atol=1e-12)


def test_fixed_to_the_room_only_the_azimuth_of_a_camera_counts():
    # Held sideways, from above, and looking almost straight down.
    cameras = [camera(100.0, 20.0), camera(10.0, 30.0), camera(70.0, 55.0, roll=90.0), camera(-50.0, 88.0)]
    for turn, degrees in zip(
        turns(manifest(*cameras, fixed_to="room")), (-90.0, 0.0, -60.0, 60.0), strict=True
    ):
        np.testing.assert_allclose(turn, about(UP, degrees), atol=1e-12)


def test_on_a_level_ring_camera_and_room_are_the_same():
    ring = [camera(azimuth, 32.0) for azimuth in (0.0, 40.0, 130.0, 300.0)]
    for one, other in zip(turns(manifest(*ring)), turns(manifest(*ring, fixed_to="room")), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-12)


def test_a_light_that_stands_still_with_the_scene_has_no_turn():
    made = manifest(camera(0.0, 10.0), camera(50.0, 10.0), fixed_to="scene")
    assert turns(made) == [None, None]
    assert not made.light_fixed_to
    assert not made.light_frame


def test_turns_move_with_the_world():
    made = manifest(camera(0.0, 10.0), camera(50.0, 10.0), camera(99.0, 40.0))
    before = turns(made)
    matrix = np.eye(4)
    matrix[:3, :3] = 2.0 * about((1.0, 0.4, 0.0), 35.0)
    move(made, matrix)
    rotation = matrix[:3, :3] / 2.0
    for old, new in zip(before, turns(made), strict=True):
        np.testing.assert_allclose(new, rotation @ old @ rotation.T, atol=1e-12)


def test_another_capture_takes_the_frame_of_the_trained_light():
    trained = manifest(camera(0.0, 10.0), camera(50.0, 10.0))
    other = manifest(camera(80.0, 10.0), fixed_to="scene")
    adopt_light(other, trained)
    np.testing.assert_allclose(turns(other)[0], camera(50.0, 10.0) @ camera(80.0, 10.0).T, atol=1e-12)


def test_an_unknown_setting_is_refused():
    assert as_light_fixed_to("room") == "room"
    with pytest.raises(UsageError, match=r"light\.fixed_to_unknown.*auto, scene, camera, room"):
        as_light_fixed_to("flash")
