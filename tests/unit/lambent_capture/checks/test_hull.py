"""The visual hull of a ball seen from all around is the ball; single wrong views do not spoil it."""

import numpy as np
import pytest
from lambent_capture.checks.hull import carve, footprint, grown, tolerated_views
from lambent_capture.scenes.silhouettes import Silhouette
from support.ball_views import RADIUS, ball_camera, ball_views

LOW, HIGH = np.full(3, -1.5), np.full(3, 1.5)
CENTRE = (0.2, -0.1, 0.3)


def carved(views, **changes):
    return carve(views, LOW, HIGH, **{"cells": 32, "tolerated": 1, **changes})


@pytest.fixture(scope="module")
def views():
    return ball_views(24, CENTRE)


def test_the_hull_of_a_ball_is_the_ball_up_to_a_cell(views):
    hull = carved(views)
    solid = hull.points[hull.cells(hull.against(), 0)]
    distance = np.linalg.norm(solid - np.array(CENTRE), axis=1)
    assert distance.max() < RADIUS + 2.0 * hull.spacing
    volume = len(solid) * hull.spacing**3
    assert volume == pytest.approx(4.0 / 3.0 * np.pi * RADIUS**3, rel=0.12)


def test_the_grid_closes_in_on_the_object(views):
    hull = carved(views)
    assert hull.spacing < 0.6 * 3.0 / 32
    assert hull.shape[0] * hull.shape[1] * hull.shape[2] == len(hull.points)


def test_one_empty_silhouette_is_tolerated_and_two_are_not(views):
    empty = [Silhouette(view.camera, np.zeros_like(view.mask)) for view in views]
    assert carved([empty[0], *views[1:]]) is not None
    assert carved([empty[0], empty[1], *views[2:]]) is None


def test_without_a_view_its_contradictions_do_not_count(views):
    empty = Silhouette(views[0].camera, np.zeros_like(views[0].mask))
    hull = carved([empty, *views[1:]])
    against = hull.against()
    assert not hull.cells(against, 0).any()
    assert hull.cells(against, 0, without=0).sum() > 100
    trusted = np.arange(len(views)) > 0
    assert (hull.cells(hull.against(trusted), 0) == hull.cells(against, 0, without=0)).all()


def test_what_hardly_any_picture_shows_does_not_belong_to_the_hull(views):
    away = [Silhouette(ball_camera(np.array([1.0, 0.0, 0.0])), np.ones((64, 64), dtype=bool))] * 24
    hull = carved(away)
    # The cone of the one picture continues behind the object; beside it nothing is shown.
    column, row, _ = away[0].camera.project(hull.points[hull.cells(hull.against(), 0)])
    assert (np.abs(np.stack([column, row]) - 32.0) <= 32.0).all()


def test_a_thin_object_is_not_lost_between_the_first_coarse_cells():
    views = []
    for view in ball_views(16):
        line = np.zeros_like(view.mask)
        column, row, _ = view.camera.project(np.linspace([0, 0, -0.6], [0, 0, 0.6], 400))
        line[row.astype(int), column.astype(int)] = True
        views.append(Silhouette(view.camera, line))
    assert carved(views, cells=64) is not None


def test_the_footprint_of_a_hull_covers_every_silhouette(views):
    hull = carved(views)
    cells = hull.points[hull.cells(hull.against(), 1)]
    for view in views:
        assert not (view.mask & ~footprint(view.camera, cells, hull.spacing)).any()


def test_nothing_has_no_footprint(views):
    assert not footprint(views[0].camera, np.zeros((0, 3)), 0.1).any()


def test_growing_is_by_squares():
    dot = np.zeros((7, 7), dtype=bool)
    dot[3, 3] = True
    assert grown(dot, 1).sum() == 9
    assert grown(dot, 0).sum() == 1


@pytest.mark.parametrize(("num_views", "expected"), [(3, 1), (10, 1), (50, 4), (100, 8)])
def test_some_views_may_be_wrong(num_views, expected):
    assert tolerated_views(num_views, 0.08) == expected
