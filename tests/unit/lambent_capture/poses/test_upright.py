"""Up is found from how cameras were held, sideways ones and some mistaken ones included."""

import numpy as np
import pytest
from lambent_capture.poses.upright import turned_upright, up_direction
from lambent_capture.scenes.world import shortest_turn
from scipy.spatial.transform import Rotation
from support.captures import look_at

COUNT = 16
TURN = Rotation.from_euler("xyz", [40.0, -70.0, 20.0], degrees=True).as_matrix()


def held(turns, askew_deg=4.0):
    """Return OpenCV poses around an object whose up is `TURN`'s third column, each camera turned by quarters.

    A camera turned by one quarter counterclockwise stores up at the right side of its picture, and so on.
    """
    rng = np.random.default_rng(0)
    poses = []
    for number, quarters in enumerate(turns):
        azimuth = 2.0 * np.pi * number / len(turns)
        pose = look_at(np.array([np.cos(azimuth), np.sin(azimuth), 0.5 + 0.4 * (number % 3)]))
        pose[:3, 1:3] *= -1.0
        roll = Rotation.from_euler("z", -90.0 * quarters + askew_deg * rng.normal(), degrees=True)
        pose[:3, :3] = TURN @ pose[:3, :3] @ roll.as_matrix()
        poses.append(pose)
    return np.array(poses)


def angle_deg(up):
    return np.degrees(np.arccos(np.clip(up @ TURN[:, 2], -1.0, 1.0)))


@pytest.mark.parametrize("turns", [[0] * COUNT, [3] * COUNT, [0, 1, 3, 2] * (COUNT // 4)])
def test_up_is_found_however_the_telephone_was_held(turns):
    assert angle_deg(up_direction(held(turns), turns)) < 3.0


def test_a_few_wrong_turns_do_no_harm():
    turns = [0, 3] * (COUNT // 2)
    said = list(turns)
    said[2], said[5], said[9] = 1, 0, 2
    assert angle_deg(up_direction(held(turns), said)) < 3.0


def test_without_turns_cameras_that_were_all_held_one_way_tell_up():
    assert angle_deg(up_direction(held([3] * COUNT), [0] * COUNT)) < 3.0


def test_cameras_held_anyhow_tell_nothing():
    rng = np.random.default_rng(1)
    poses = held([0] * COUNT)
    poses[:, :3, :3] = Rotation.random(COUNT, random_state=rng).as_matrix()
    assert up_direction(poses, [0] * COUNT) is None


def test_turned_cameras_look_the_same_way_and_four_turns_are_none():
    poses = held([0] * COUNT)
    assert np.array_equal(turned_upright(poses, [4] * COUNT), poses)
    once = turned_upright(poses, [1] * COUNT)
    assert np.array_equal(once[:, :3, 2], poses[:, :3, 2])
    assert np.allclose(np.linalg.det(once[:, :3, :3]), 1.0)
    # Up was at the right side, so that is the upper side of the turned picture.
    assert np.allclose(-once[:, :3, 1], poses[:, :3, 0])


def test_the_shortest_turn_takes_up_to_z():
    for up in np.vstack([np.eye(3), -np.eye(3), TURN.T]):
        assert np.allclose(shortest_turn(up) @ up, [0.0, 0.0, 1.0])
        assert np.linalg.det(shortest_turn(up)) == pytest.approx(1.0)
