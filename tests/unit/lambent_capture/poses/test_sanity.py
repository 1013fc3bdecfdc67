"""Models with points behind cameras, beside them, at infinity or nowhere, and cameras that are wrong."""

import numpy as np
import pycolmap
import pytest
from lambent_capture.poses.mapping import refine
from lambent_capture.poses.sanity import MIN_SIGHTINGS, drop_unusable, outlier_limit_px
from lambent_capture.poses.solution import mean_error_px

COUNT, POINTS = 6, 80


@pytest.fixture
def model():
    """Return a synthetic model whose points are exactly where they are seen."""
    options = pycolmap.SyntheticDatasetOptions()
    options.num_frames_per_rig, options.num_rigs, options.num_cameras_per_rig = COUNT, 1, 1
    options.num_points3D = POINTS
    pycolmap.set_random_seed(1)
    made = pycolmap.synthesize_dataset(options)
    made.update_point_3d_errors()
    return made


def first_camera(model):
    """Return centre and axes (rows: right, down, ahead) of a camera."""
    image = model.image(min(model.reg_image_ids()))
    return image.projection_center(), image.cam_from_world().rotation.matrix()


def behind(model):
    centre, axes = first_camera(model)
    return centre - 5.0 * axes[2]


def beside(model):
    centre, axes = first_camera(model)
    return centre + axes.T @ np.array([1.0, 0.3, 1e-60])


PLACES = {
    "behind a camera": behind,
    "beside a camera": beside,
    "far off": lambda model: np.array([1e200, 0.0, 0.0]),
    "at infinity": lambda model: np.array([np.inf, 0.0, 0.0]),
    "nowhere": lambda model: np.full(3, np.nan),
    "elsewhere": lambda model: model.point3D(max(model.point3D_ids())).xyz + 0.5,
}


@pytest.mark.parametrize("place", PLACES)
def test_a_point_that_cannot_be_is_taken_out_and_the_error_is_that_of_the_others(model, place):
    wrong = min(model.point3D_ids())
    model.point3D(wrong).xyz = PLACES[place](model)
    model.update_point_3d_errors()
    assert not mean_error_px(model) < 0.5
    assert drop_unusable(model) == []
    assert wrong not in model.points3D
    assert model.num_points3D() == POINTS - 1
    assert mean_error_px(model) < 1e-6


@pytest.mark.parametrize("place", ["behind a camera", "beside a camera"])
def test_such_a_point_is_why_an_error_had_150_digits(model, place):
    model.point3D(min(model.point3D_ids())).xyz = PLACES[place](model)
    model.update_point_3d_errors()
    assert mean_error_px(model) > 1e100


def test_refining_leaves_a_model_that_can_be(model):
    wrong = sorted(model.point3D_ids())[:3]
    for point, place in zip(wrong, (behind, beside, PLACES["far off"]), strict=True):
        model.point3D(point).xyz = place(model)
    refine(model)
    assert model.num_reg_images() == COUNT
    assert model.num_points3D() >= POINTS - len(wrong)
    assert mean_error_px(model) < 0.1


def test_what_the_last_adjustment_pushed_behind_a_camera_is_taken_out(model, monkeypatch):
    pushed = []

    class Pushing:
        def solve(self):
            pushed.append(min(model.point3D_ids()))
            model.point3D(pushed[-1]).xyz = behind(model)

    monkeypatch.setattr(pycolmap, "create_default_bundle_adjuster", lambda *_: Pushing())
    refine(model)
    assert pushed
    assert not set(pushed) & set(model.point3D_ids())
    assert mean_error_px(model) < 1e-6


def test_a_camera_that_no_points_support_is_left_out_and_named(model):
    image = model.image(min(model.reg_image_ids()))
    seen = [point.point3D_id for point in image.points2D if point.has_point3D()]
    manager = pycolmap.ObservationManager(model)
    places = [at for at, point in enumerate(image.points2D) if point.has_point3D()]
    for at in places[: len(seen) - MIN_SIGHTINGS + 1]:
        manager.delete_observation(image.image_id, at)
    assert drop_unusable(model) == [image.name]
    assert model.num_reg_images() == COUNT - 1


@pytest.mark.parametrize("shift", [1e9, np.nan])
def test_a_camera_far_off_or_nowhere_is_left_out(model, shift):
    image = model.image(min(model.reg_image_ids()))
    pose = image.cam_from_world()
    model.frame(image.frame_id).set_cam_from_world(
        image.camera_id, pycolmap.Rigid3d(pose.rotation, pose.translation + shift)
    )
    assert drop_unusable(model) == [image.name]
    assert model.num_reg_images() == COUNT - 1
    assert mean_error_px(model) < 1e-6


def test_a_good_model_stays_as_it_is(model):
    assert drop_unusable(model) == []
    assert (model.num_reg_images(), model.num_points3D()) == (COUNT, POINTS)
    assert outlier_limit_px(model) == 1.0
