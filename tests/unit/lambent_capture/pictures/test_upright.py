"""Photographs that are stored lying down are shown, and trained on, as the camera was held."""

import numpy as np
import pytest
from lambent_capture.loading.load import turned
from lambent_capture.pictures.upright import turned_pose, turned_size, upright_turns
from lambent_core.scene import Camera, Margins, View
from support.captures import look_at

EYE = np.array([3.0, 1.0, 1.2])
WIDTH, HEIGHT = 40, 30


def camera(turns: int, eye: np.ndarray = EYE) -> Camera:
    """Return a camera whose picture needs so many quarter turns to the left to be upright."""
    size = turned_size((WIDTH, HEIGHT), turns)
    return Camera(
        width=size[0],
        height=size[1],
        focal_x=50.0 if turns % 2 == 0 else 52.0,
        focal_y=52.0 if turns % 2 == 0 else 50.0,
        centre_x=17.0,
        centre_y=14.0,
        camera_to_world=turned_pose(look_at(eye, np.zeros(3)), -turns),
    )


def pixel_of(seen: Camera, point: np.ndarray) -> tuple[float, float]:
    """Return column and row at which a camera shows a point of the world."""
    x, y, z = np.linalg.inv(seen.camera_to_world)[:3] @ np.append(point, 1.0)
    return seen.centre_x + seen.focal_x * x / -z, seen.centre_y - seen.focal_y * y / -z


@pytest.mark.parametrize("turns", range(4))
def test_the_turn_is_found_from_the_camera(turns):
    assert upright_turns(camera(turns).camera_to_world) == turns


@pytest.mark.parametrize("turns", range(4))
def test_cameras_that_look_straight_down_are_left_as_they_are(turns):
    from_above = camera(turns, np.array([0.05, 0.0, 4.0]))
    assert upright_turns(from_above.camera_to_world) == 0


@pytest.mark.parametrize("turns", range(4))
def test_pictures_cameras_and_margins_turn_together(turns):
    lying = camera(turns)
    column, row = pixel_of(lying, np.array([0.2, 0.1, 0.25]))
    picture = np.zeros((lying.height, lying.width, 4), np.float32)
    picture[int(row), int(column)] = 1.0
    flags = picture[..., :3] > 0.0
    margins = {side: number for number, side in enumerate(("left", "top", "right", "bottom"))}
    view = View(
        name="v", camera=lying, images={"l": picture}, clipped={"l": flags}, margins=Margins(**margins)
    )
    upright = turned(view, upright_turns(lying.camera_to_world))
    assert (upright.camera.width, upright.camera.height) == (WIDTH, HEIGHT)
    assert upright_turns(upright.camera.camera_to_world) == 0
    column, row = pixel_of(upright.camera, np.array([0.2, 0.1, 0.25]))
    assert upright.images["l"][int(row), int(column)].tolist() == [1.0] * 4
    assert upright.clipped["l"][int(row), int(column)].all()
    # The side that is on top now was `turns` sides further on.
    order = [upright.margins.left, upright.margins.top, upright.margins.right, upright.margins.bottom]
    assert order == [(side + turns) % 4 for side in range(4)]
    np.testing.assert_array_equal(upright.camera.position, lying.position)
