"""The support below the object: what views agree on is known, and what is below the object is likely it."""

import numpy as np
import pytest
from lambent_capture.masks.consensus import ConsensusSettings, MaskView, _Grid, _with_what_stands_below
from lambent_capture.masks.footprint import uncovered
from lambent_capture.masks.lattice import SCENE, Lattice
from lambent_capture.masks.orthophoto import Orthophoto, SupportViews
from lambent_capture.masks.plane_maps import OrthoGrid
from lambent_capture.masks.support_plane import SupportPlane
from lambent_capture.scenes.picture_camera import PictureCamera

CELLS, VIEWS, DISTANCE = 40, 10, 4.0
MIDDLE = np.s_[16:24, 16:24]
PAPER = np.array([80.0, 0.0, 0.0])
CAMERA = PictureCamera(
    width=CELLS, height=CELLS, focal=(40.0, 40.0), centre=(20.0, 20.0), camera_to_world=np.eye(4)
)


def coded(lab: np.ndarray) -> np.ndarray:
    return np.round(lab * [2.55, 1.0, 1.0] + [0.0, 128.0, 128.0]).astype(np.uint8)


def scene(lightness: np.ndarray, hides: int = 0) -> tuple[SupportViews, Orthophoto, list[np.ndarray]]:
    """Return views of paper whose middle looks like `lightness` in each, and is unknown in the orthophoto.

    In the first `hides` views the object is believed to hide all of it.
    """
    plane = SupportPlane(origin=np.zeros(3), axes=np.eye(3))
    grid = OrthoGrid(plane=plane, half=1.0, cells=CELLS)
    picture = np.zeros((CELLS, CELLS, 3), np.uint8)
    support = SupportViews(
        grid, [MaskView(f"v{k}", picture, CAMERA) for k in range(VIEWS)], np.ones((VIEWS, 3))
    )
    rows, columns = np.mgrid[:CELLS, :CELLS].astype(np.int16)
    for light in lightness:
        lab = np.broadcast_to(PAPER, (CELLS, CELLS, 3)).copy()
        lab[MIDDLE] = [light, 0.0, 0.0]
        support.warped.append(coded(lab))
        support.maps.append((np.dstack([columns, rows]), np.zeros((CELLS, CELLS), np.uint16)))
    hidden = np.zeros((CELLS, CELLS), bool)
    hidden[MIDDLE] = True
    ortho = Orthophoto(
        lab=np.broadcast_to(PAPER, (CELLS, CELLS, 3)).astype(np.float32),
        # A pattern that differs much from place to place, as print does.
        spread=np.where(hidden[..., None], 6.0, 1.5).astype(np.float32) * np.ones(2, np.float32),
        known=np.where(hidden, 0.0, 1.0).astype(np.float32),
        hidden=hidden,
    )
    ortho.lab[::3, :, 0] -= 25.0
    beliefs = [np.full((CELLS, CELLS), float(view < hides)) for view in range(VIEWS)]
    return support, ortho, beliefs


@pytest.mark.parametrize(
    ("lightness", "hides", "is_known"),
    [
        (np.full(VIEWS, 74.0), 0, True),
        # The sides of a cup that every view sees another one of: each could be the paper, all cannot.
        (np.linspace(62.0, 82.0, VIEWS), 0, False),
        # Six views see the cup in front of it and are known to; the other four agree.
        (np.where(np.arange(VIEWS) < 6, 30.0, 74.0), 6, True),
        (np.where(np.arange(VIEWS) < 6, 30.0, 74.0), 0, False),
        # Two views are too few.
        (np.full(VIEWS, 74.0), 8, False),
    ],
)
def test_what_free_views_agree_on_is_known(lightness, hides, is_known):
    support, ortho, beliefs = scene(lightness, hides)
    nothing = np.full(26 * 40 * 40, 1e-9)
    found = uncovered(support, ortho, beliefs, nothing, DISTANCE)
    assert (not found.hidden[MIDDLE].any()) == is_known
    assert found.known[MIDDLE].all() == is_known
    if is_known:
        np.testing.assert_allclose(found.lab[MIDDLE][..., 0], 74.0, atol=0.5)


def test_cells_below_the_object_get_votes_and_others_do_not():
    lattice = Lattice(frame=SCENE, low=np.zeros(3), spacing=1.0, shape=(1, 2, 4))
    votes = np.array([[[-9.0, -1.0, 5.0, -1.0], [-1.0, -1.0, -1.0, -1.0]]])
    settings = ConsensusSettings(standing=0.5, most_standing=3.0)
    grid = _Grid(lattice, [CAMERA] * 10, [])
    raised = _with_what_stands_below(votes.ravel(), grid, settings).reshape(votes.shape)
    np.testing.assert_array_equal(raised[0, 0], [-4.0, 3.0, 5.0, -1.0])
    np.testing.assert_array_equal(raised[0, 1], votes[0, 1])
