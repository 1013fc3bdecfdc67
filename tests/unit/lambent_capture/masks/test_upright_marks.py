"""A person's marks on an upright picture land on the pixels that the file stores lying down."""

from types import SimpleNamespace

import numpy as np
import pytest
from lambent_capture.masks.corrections import Correction
from lambent_capture.masks.propagate import _seeds
from lambent_capture.pictures.upright import turned_pixels, turned_pose, turned_size
from lambent_capture.scenes.picture_camera import PictureCamera
from support.captures import look_at


@pytest.mark.parametrize("turns", range(4))
def test_a_mark_in_the_upper_left_corner_of_what_is_shown(turns):
    upright_mark = np.zeros((30, 40), np.int8)
    upright_mark[2:8, 4:14] = -1
    width, height = turned_size((80, 60), -turns)
    pose = turned_pose(look_at(np.array([3.0, 1.0, 1.2]), np.zeros(3)), -turns)
    centre = (width / 2, height / 2)
    camera = PictureCamera(
        width=width, height=height, focal=(90.0, 90.0), centre=centre, camera_to_world=pose
    )
    stored = np.zeros((height // 2, width // 2, 3), np.uint8)
    work = SimpleNamespace(names=("a",), pictures=(stored,), cameras=(camera,))
    # In pixels of the photograph, which is twice as large as the kept picture.
    mark = Correction(frame="a", is_object=False, points=((8.0, 4.0), (28.0, 16.0)))
    np.testing.assert_array_equal(_seeds(work, [mark])[0], turned_pixels(upright_mark, -turns))
