"""The plane that an object stands on is found among sparse points."""

import numpy as np
from lambent_capture.masks.support_plane import find_support

CAMERAS = np.array([[np.cos(a), np.sin(a), 0.8] for a in np.linspace(0, 6, 12)]) * 3.0


def cloud(seed: int = 0) -> np.ndarray:
    generator = np.random.default_rng(seed)
    table = np.column_stack([generator.uniform(-1.5, 1.5, (300, 2)), generator.normal(0, 0.004, 300)])
    thing = generator.uniform([-0.3, -0.3, 0.0], [0.3, 0.3, 0.8], (300, 3))
    return np.concatenate([table, thing, generator.uniform(-2, 2, (30, 3)) * [1, 1, 0.5] + [0, 0, 1.1]])


def test_the_plane_below_everything_is_found_and_faces_the_cameras():
    plane = find_support(cloud(), CAMERAS, np.array([0.0, 0.0, 0.3]), 3.8)
    assert plane.normal @ [0, 0, 1] > np.cos(np.radians(0.5))
    assert abs(plane.origin[2]) < 0.01
    assert np.allclose(plane.axes @ plane.axes.T, np.eye(3))
    assert np.allclose(np.cross(plane.axes[0], plane.axes[1]), plane.normal)


def test_coordinates_of_the_plane_are_undone_by_its_inverse():
    plane = find_support(cloud(), CAMERAS, np.array([0.0, 0.0, 0.3]), 3.8)
    points = np.random.default_rng(1).normal(size=(20, 3))
    assert np.allclose(plane.world(plane.local(points)), points)
    assert np.allclose(plane.local(points)[:, 2], (points - plane.origin) @ plane.normal)


def test_a_ceiling_or_the_lid_of_a_box_is_no_support():
    lid = cloud()
    lid[:300, 2] += 0.8  # The most points are now above the thing, with all of it below.
    plane = find_support(lid, CAMERAS, np.array([0.0, 0.0, 0.3]), 3.8)
    assert plane is None or abs(plane.origin[2] - 0.8) > 0.1


def test_too_few_points_and_points_without_a_plane_show_none():
    assert find_support(cloud()[:20], CAMERAS, np.zeros(3), 3.8) is None
    scattered = np.random.default_rng(2).normal(size=(400, 3))
    assert find_support(scattered, CAMERAS, np.zeros(3), 3.8) is None
