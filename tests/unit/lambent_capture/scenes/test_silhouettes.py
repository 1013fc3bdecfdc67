"""The hull that masks leave holds the object, and nothing else explains them."""

import numpy as np
import pytest
from lambent_capture.scenes.picture_camera import PictureCamera
from lambent_capture.scenes.silhouettes import Silhouette, carve, explained, other_convention
from support.layouts import OPENCV
from support.uneven_object import BALLS, FOCAL, SIDE, coverage, poses

SCALED = 2 * SIDE


def views(axes=None, count=16):
    turn = np.eye(4) if axes is None else axes
    return [
        Silhouette(
            PictureCamera(
                width=SCALED,
                height=SCALED,
                focal=(FOCAL * 2, FOCAL * 2),
                centre=(SCALED / 2, SCALED / 2),
                camera_to_world=pose @ turn,
            ),
            coverage(pose, SCALED) > 0,
            str(index),
        )
        for index, pose in enumerate(poses()[:count])
    ]


@pytest.fixture(scope="module")
def hull():
    return carve(views())


def test_the_box_of_the_hull_holds_the_object_and_little_more(hull):
    low, high = hull.box
    true_low = np.min([np.array(centre) - radius for centre, radius in BALLS], axis=0)
    true_high = np.max([np.array(centre) + radius for centre, radius in BALLS], axis=0)
    assert (low < true_low).all()
    assert (high > true_high).all()
    assert ((high - low) < 1.3 * (true_high - true_low)).all()
    assert not hull.open_low.any()
    assert not hull.open_high.any()


def test_every_mask_is_explained_by_the_hull(hull):
    np.testing.assert_array_equal(explained(views(), hull), 1.0)


def test_nothing_is_explained_without_a_hull():
    assert carve(views(OPENCV)) is None
    np.testing.assert_array_equal(explained(views(), None), 0.0)


def test_cameras_on_one_side_leave_the_other_side_open():
    above = [view for view in views() if view.camera.position[2] > 0.8]
    hull = carve(above)
    assert hull.open_low[2]
    assert not hull.open_high[2]


@pytest.mark.parametrize(
    ("axes", "words"),
    [
        (OPENCV, "diag(1, -1, -1, 1)"),
        (np.diag([-1.0, -1.0, 1.0, 1.0]), "upside down"),
        (np.diag([-1.0, 1.0, -1.0, 1.0]), "x left, y up, z forward"),
    ],
)
def test_the_convention_of_turned_poses_is_found(axes, words):
    assert words in other_convention(views(axes), better_than=0.0).advice


def test_no_convention_is_better_than_the_right_one():
    assert other_convention(views(), better_than=1.0) is None


def test_one_wrong_mask_of_many_does_not_cut_the_object_away(hull):
    several = views()
    several[3].mask[:] = False
    several[3].mask[2:6, 2:6] = True
    lenient = carve(several, one_may_differ_from=7)
    shares = explained(several, lenient)
    assert shares[3] < 0.5
    assert np.delete(shares, 3).min() > 0.99
    assert carve(several) is None
