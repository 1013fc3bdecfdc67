"""Points of a textured box are found where the box is, with cameras that are known."""

import numpy as np
import pytest
from lambent_capture.masks.consensus import MaskView
from lambent_capture.masks.triangulate import TriangulateSettings, neighbours, triangulate
from support.ball_on_table import of_pictures
from support.textured_box import HALF, box_cameras, box_picture


@pytest.mark.slow
def test_points_lie_on_the_box_or_its_plate():
    cameras = box_cameras(6, arc_deg=75.0)
    views = [MaskView(f"v{i}", box_picture(camera)[0], camera) for i, camera in enumerate(cameras)]
    told = []
    found = triangulate(of_pictures(views), np.zeros(3), progress=lambda *each: told.append(each))
    assert len(found.xyz) == len(found.seen_by) > 100
    outside = np.maximum(np.abs(found.xyz) - HALF, 0.0)
    on_box = (np.linalg.norm(outside, axis=1) < 0.02) & (np.abs(np.abs(found.xyz) - HALF).min(axis=1) < 0.02)
    on_plate = np.abs(found.xyz[:, 2] + HALF[2]) < 0.03
    assert (on_box | on_plate).mean() > 0.95
    assert on_box.sum() > 30
    assert told[0] == ("looking for points", 1, 6)
    assert told[-1][0] == "placing points"


def test_pictures_without_features_have_no_points():
    cameras = box_cameras(4)
    views = [MaskView(f"v{i}", np.full((320, 320, 3), 90, np.uint8), c) for i, c in enumerate(cameras)]
    assert triangulate(of_pictures(views), np.zeros(3)).xyz.shape == (0, 3)


def test_views_are_compared_with_their_neighbours_but_not_with_twins():
    offsets = np.array([[np.cos(a), np.sin(a), 0.0] for a in np.radians([0, 0.5, 20, 40, 120])])
    pairs = neighbours(offsets, TriangulateSettings())
    assert (0, 1) not in pairs
    assert {(0, 2), (1, 2), (2, 3), (0, 3)} <= set(pairs)
    assert all(4 not in pair for pair in pairs)
