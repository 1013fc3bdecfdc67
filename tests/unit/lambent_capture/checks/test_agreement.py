"""Silhouettes against the hull of the others, on a ball; whole captures are in test_capture_damage."""

from dataclasses import replace

import numpy as np
import pytest
from lambent_capture.checks.agreement import compare
from lambent_capture.checks.hull import carve
from lambent_capture.scenes.silhouettes import Silhouette
from support.ball_views import ball_camera, ball_views

LOW, HIGH = np.full(3, -1.5), np.full(3, 1.5)


@pytest.fixture(scope="module")
def views():
    return ball_views(24)


def agreements(views):
    hull = carve(views, LOW, HIGH, cells=40, tolerated=2)
    return compare(hull, views, tolerated=2, unexplained_limit=0.02)


def painted(view, rows, columns, value):
    mask = view.mask.copy()
    mask[rows, columns] = value
    return Silhouette(view.camera, mask)


def test_true_silhouettes_agree(views):
    for each in agreements(views):
        assert each.unexplained_share < 0.005
        assert each.carved_share == each.hole_share == each.speck_share == 0.0


def test_too_much_in_one_mask_is_unexplained_in_it_alone(views):
    first, *others = agreements([painted(views[0], slice(0, 8), slice(0, 8), True), *views[1:]])
    extra = 64 / (views[0].mask.sum() + 64)
    assert first.unexplained_share == pytest.approx(extra, abs=0.01)
    assert first.moved_share > 0.65
    assert max(each.unexplained_share for each in others) < 0.005


def test_too_little_in_one_mask_is_cut_away_from_the_others(views):
    first, *others = agreements([painted(views[0], slice(0, 24), slice(None), False), *views[1:]])
    assert first.carved_share > 0.05
    assert first.unexplained_share < 0.005
    assert max(each.carved_share for each in others) == 0.0


def test_a_shifted_silhouette_would_fit_elsewhere(views):
    shifted = Silhouette(views[0].camera, np.roll(views[0].mask, (5, -4), axis=(0, 1)))
    first, *others = agreements([shifted, *views[1:]])
    assert first.unexplained_share > 0.05
    assert first.moved_share < 0.2
    assert max(each.unexplained_share for each in others) < 0.005


def test_islands_are_counted(views):
    mask = views[0].mask.copy()
    mask[[2, 2, 60, 58], [3, 50, 4, 60]] = True
    first = agreements([Silhouette(views[0].camera, mask), *views[1:]])[0]
    assert first.num_specks == 4
    assert first.speck_share == pytest.approx(4 / mask.sum())


def test_a_hole_counts_where_neighbours_could_look_through_it_too(views):
    holed = painted(views[0], slice(28, 36), slice(28, 36), False)
    # These views lie about 40 degrees apart.
    assert agreements([holed, *views[1:]])[0].hole_share == 0.0
    near = [Silhouette(beside(views[0].camera, step), views[0].mask) for step in (-0.3, 0.3, 0.4)]
    found = agreements([holed, *near, *views[1:]])
    assert found[0].hole_share == pytest.approx(64 / holed.mask.sum(), rel=0.1)
    assert max(each.hole_share for each in found[1:]) == 0.0


def beside(camera, step):
    return ball_camera(camera.position / 4.0 + step * camera.camera_to_world[:3, 0])


def test_a_view_in_doubt_has_no_say_about_the_others(views):
    elsewhere = Silhouette(views[0].camera, np.roll(views[0].mask, 20, axis=1))
    _, *others = agreements([elsewhere, *views[1:]])
    assert max(max(each.missed_share, each.carved_share) for each in others) < 0.02


def test_disagreement_of_everyone_leaves_everyone_a_say(views):
    shaken = [
        replace(view, mask=np.roll(view.mask, (-1) ** index * 6, axis=index % 2))
        for index, view in enumerate(views)
    ]
    hull = carve(shaken, LOW, HIGH, cells=40, tolerated=8)
    found = compare(hull, shaken, tolerated=2, unexplained_limit=0.02)
    assert np.median([each.unexplained_share for each in found]) > 0.02
