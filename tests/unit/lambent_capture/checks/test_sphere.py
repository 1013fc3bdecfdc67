"""The sphere of views: where gaps are, and how wide."""

import numpy as np
import pytest
from lambent_capture.checks.sphere import angles_deg, fibonacci_sphere, largest_gap, unit_directions


def ring(elevation_deg: float, count: int, share: float = 1.0) -> np.ndarray:
    turn = np.linspace(0.0, share * 2.0 * np.pi, count, endpoint=False)
    height, radius = np.sin(np.radians(elevation_deg)), np.cos(np.radians(elevation_deg))
    return np.stack([radius * np.cos(turn), radius * np.sin(turn), np.full(count, height)], axis=-1)


def test_directions_point_from_the_object_to_the_camera():
    found = unit_directions(np.array([[2.0, 1.0, 1.0]]), np.array([0.0, 1.0, 1.0]))
    np.testing.assert_allclose(found, [[1.0, 0.0, 0.0]])


def test_azimuth_turns_from_x_to_y_and_elevation_is_above_the_horizon():
    azimuth, elevation = angles_deg(np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]))
    assert azimuth[:2] == pytest.approx([90.0, 180.0])
    assert elevation == pytest.approx([0.0, 0.0, 90.0])


def test_a_ring_leaves_the_zenith_open():
    gap = largest_gap(ring(25.0, 40), lowest_deg=0.0)
    assert gap.radius_deg == pytest.approx(65.0, abs=2.0)
    assert gap.elevation_deg > 85.0


def test_half_a_ring_leaves_the_other_half_open():
    gap = largest_gap(ring(5.0, 20, share=0.5), lowest_deg=0.0)
    assert gap.radius_deg > 85.0
    assert gap.azimuth_deg == pytest.approx(-90.0, abs=10.0)


def test_what_lies_below_the_horizon_is_a_gap_only_where_that_counts():
    upper = fibonacci_sphere(200)[:100]
    assert largest_gap(upper, lowest_deg=0.0).radius_deg < 20.0
    below = largest_gap(upper, lowest_deg=-90.0)
    assert below.radius_deg > 80.0
    assert below.elevation_deg < -80.0


def test_evenly_spread_directions_are_unit_and_leave_no_gap():
    directions = fibonacci_sphere(1000)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=-1), 1.0)
    assert largest_gap(directions, lowest_deg=-90.0).radius_deg < 5.0
