"""Exposure from common points: exact on made-up values, robust to highlights, blind to what is hidden."""

import numpy as np
import pytest
from lambent_capture.checks.brightness import (
    deviation_from_neighbours,
    relative_exposure,
    surface_luminance,
)
from lambent_capture.checks.hull import carve
from lambent_capture.checks.sphere import fibonacci_sphere
from support.ball_views import RADIUS, ball_hits, ball_views

OFFSETS = np.array([0.0, 0.5, -0.3, 0.0, 1.0, 0.0, -0.1])


def seen_by(offsets: np.ndarray, *, share: float = 0.6, noise: float = 0.0) -> np.ndarray:
    """Return log2 luminance of 400 points, each in a share of the views."""
    generator = np.random.default_rng(0)
    values = (
        offsets[:, None] + generator.normal(size=400) + noise * generator.normal(size=(len(offsets), 400))
    )
    values[generator.random(values.shape) > share] = np.nan
    return values


def test_offsets_of_views_are_recovered_whatever_the_points_look_like():
    found = relative_exposure(seen_by(OFFSETS))
    assert found.offsets == pytest.approx(OFFSETS - np.median(OFFSETS), abs=1e-3)
    assert found.mismatch == pytest.approx(np.zeros(7), abs=1e-3)


def test_highlights_in_some_points_do_not_count():
    seen = seen_by(OFFSETS, noise=0.05)
    seen[2, :120] += 2.0
    assert relative_exposure(seen).offsets == pytest.approx(OFFSETS - np.median(OFFSETS), abs=0.03)


def test_views_that_are_linked_by_others_only_are_compared():
    seen = np.full((3, 200), np.nan)
    base = np.random.default_rng(1).normal(size=200)
    seen[0, :90], seen[1, 50:150], seen[2, 110:] = base[:90], base[50:150] + 0.4, base[110:] + 0.8
    assert np.diff(relative_exposure(seen).offsets) == pytest.approx([0.4, 0.4], abs=1e-3)


def test_a_view_without_common_points_is_not_judged():
    seen = seen_by(OFFSETS)
    seen[3, 15:] = np.nan
    found = relative_exposure(seen)
    assert found.offsets[3] == found.mismatch[3] == 0.0


def test_a_view_of_other_points_has_a_mismatch_of_its_own():
    seen = seen_by(np.zeros(7), noise=0.05)
    seen[4] = np.random.default_rng(2).permutation(seen[4])
    found = relative_exposure(seen).mismatch
    assert found[4] > 0.4
    assert np.delete(found, 4).max() < 0.1


def test_a_view_is_compared_with_its_neighbours_and_not_with_the_far_side():
    directions = fibonacci_sphere(60)
    offsets = 0.5 * directions[:, 0]
    offsets[30] += 0.4
    deviation = deviation_from_neighbours(offsets, directions)
    assert deviation[30] == pytest.approx(0.4, abs=0.12)
    assert np.abs(np.delete(deviation, 30)).max() < 0.2


@pytest.mark.slow
def test_a_ball_shows_each_view_its_near_side_with_the_right_values():
    views = ball_views(24)
    hull = carve(views, np.full(3, -1.5), np.full(3, 1.5), cells=40, tolerated=1)
    pictures = []
    for view in views:
        hit, points = ball_hits(view.camera, np.zeros(3), RADIUS)
        pictures.append(np.where(hit, 0.3 + 0.25 * points[..., 0] / RADIUS, 0.0))
    coverage = [view.mask.astype(np.float32) for view in views]
    cameras = [view.camera for view in views]
    seen = surface_luminance(hull, hull.cells(hull.against(), 1), cameras, pictures, coverage)
    num_seen = (~np.isnan(seen)).sum(axis=1)
    # A little less than half of the surface faces a camera.
    assert num_seen.min() > 0.15 * seen.shape[1]
    assert num_seen.max() < 0.5 * seen.shape[1]
    found = relative_exposure(seen)
    assert np.abs(found.offsets).max() < 0.1
    assert found.mismatch.max() < 0.15
    darker = seen.copy()
    darker[5] -= 0.5
    assert relative_exposure(darker).offsets[5] - found.offsets[5] == pytest.approx(-0.5, abs=0.02)
