"""Finds an object that stands on a plane: what the support does not explain, as far as all views agree."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from jaxtyping import Bool
from numpy import ndarray

from lambent_capture.arrays import Cells, Grey32, Points, Reduced, Region, Texels32, Vector
from lambent_capture.masks.consensus import (
    Consensus,
    ConsensusSettings,
    Given,
    Leaning,
    MaskView,
    Prepared,
    agree,
    prepare,
)
from lambent_capture.masks.cut import LIMIT
from lambent_capture.masks.evidence import Known, learn_colours
from lambent_capture.masks.footprint import uncovered
from lambent_capture.masks.lattice import Frame
from lambent_capture.masks.orthophoto import Orthophoto, SupportViews, build
from lambent_capture.masks.plane_maps import OrthoGrid
from lambent_capture.masks.prediction import PredictionSettings, support_odds
from lambent_capture.masks.support_plane import SupportPlane

STANDING_LEAST_ODDS = -3.0
"""How sure what looks like the support is the support, for an object that looks like it, too."""


@dataclass(frozen=True, kw_only=True, slots=True)
class SupportSettings:
    """Settings of the search above a support; lengths are shares of the cameras' distance."""

    turns: int = 3
    """How often orthophoto and object are found by turns."""
    stands: bool = False
    """Whether the support below the object is unknown until views agree on it."""
    reach: float = 0.5
    """Half the side of the box that is searched, and its height is twice this."""
    ground: float = 0.9
    """Half the side of the orthophoto at most."""
    most_texels: float = 30e6
    """Texels of the orthophoto times the number of views, which bounds memory."""
    above: float = 0.012
    """Height from which sparse points are the object's, not the support's."""
    near: float = 0.35
    """Distance from the middle within which they are."""
    first_radius: float = 0.1
    """Radius of the footprint where sparse points show none."""
    leaning: Leaning = field(
        default_factory=lambda: Leaning(colour=1.0, distance=0.0, most_hull=2.5, least_hull=4.0)
    )
    first: Leaning = field(
        default_factory=lambda: Leaning(colour=0.0, distance=0.0, most_hull=2.5, least_hull=4.0)
    )
    first_rounds: ConsensusSettings = field(
        default_factory=lambda: ConsensusSettings(cells=64, rounds=2, refit_after=(0,))
    )
    rounds: ConsensusSettings = field(
        default_factory=lambda: ConsensusSettings(cells=64, rounds=3, refit_after=(0,), in_favour=0.35)
    )
    prediction: PredictionSettings = field(default_factory=PredictionSettings)

    def standing(self, votes: float, most: float) -> "SupportSettings":
        """Return settings for an object that looks like its support.

        Nothing is believed to be seen of the support below the object, as long as views do not agree on what
        they see there; and what is below the object is likely the object (`ConsensusSettings.standing`).
        """
        return replace(
            self,
            turns=self.turns + 1,
            stands=True,
            prediction=replace(self.prediction, least_odds=STANDING_LEAST_ODDS),
            rounds=replace(self.rounds, in_favour=0.6, standing=votes, most_standing=most),
            first_rounds=replace(self.first_rounds, standing=votes, most_standing=most),
        )


@dataclass(frozen=True, kw_only=True, slots=True)
class OnSupport:
    """An object on a support."""

    agreement: Consensus
    odds: list[Grey32]
    """Log odds that a pixel does not show the support, at the size of the evidence."""
    given: Given
    """What the last agreement started from."""


def find_on_support(
    small: Sequence[MaskView],
    support: SupportViews,
    footprint: Texels32,
    centre: Vector,
    distance: float,
    settings: SupportSettings,
    moved: Sequence[Region] | None = None,
) -> OnSupport | None:
    """Return the object that stands on the support, or None where the views agree on none.

    `small` are the views of `support` at the size at which they are compared. `footprint` is where the object
    probably stands, 0..1 for each texel. `moved` says which pixels of the views may show the
    object at all.
    """
    seen = prepare(small, edges=False)
    last: OnSupport | None = None
    for _ in range(settings.turns):
        # The support without the object, then what differs from it, then the object: each gets better by the
        # others.
        ortho, objects = _orthophoto(support, seen, last, footprint, distance, settings)
        odds = _unlike_support(support, ortho, objects, moved, settings)
        given = _given(small, support, ortho, odds, last, distance, settings)
        if last is None:
            # Geometry first: colours are learnt from what differs from the support, not from a ball.
            start = agree(small, centre, distance, settings.first, settings.first_rounds, given, seen)
            given = given if start is None else replace(given, beliefs=start.beliefs)
        agreement = agree(small, centre, distance, settings.leaning, settings.rounds, given, seen)
        if agreement is None:
            return None
        last = OnSupport(agreement=agreement, odds=odds, given=given)
    return last


def _orthophoto(
    support: SupportViews,
    seen: Prepared,
    last: OnSupport | None,
    footprint: Texels32,
    distance: float,
    settings: SupportSettings,
) -> tuple[Orthophoto, Cells | None]:
    """Return the support as the turn before leaves it visible, and the table of the object's colours."""
    if last is None:
        ortho = build(support, None)
        ortho.hide(footprint > 0.5)
        return ortho, None
    beliefs = last.agreement.beliefs
    ortho = build(support, beliefs)
    objects = learn_colours(seen.colours, beliefs, last.given.known).objects
    if settings.stands:
        ortho.hide(_below(support.grid, last.agreement))
    return uncovered(support, ortho, beliefs, objects, distance), objects


def _unlike_support(
    support: SupportViews,
    ortho: Orthophoto,
    objects: Cells | None,
    moved: Sequence[Region] | None,
    settings: SupportSettings,
) -> list[Grey32]:
    """Return the log odds of each view against the support; what did not `move` is never the object."""
    odds = [support_odds(support, ortho, i, objects, settings.prediction) for i in range(len(support.views))]
    if moved is None:
        return odds
    return [np.where(may, own, np.float32(-LIMIT)) for may, own in zip(moved, odds, strict=True)]


def ortho_grid(
    plane: SupportPlane, views: Sequence[MaskView], distance: float, settings: SupportSettings
) -> OrthoGrid:
    """Return the part of the support that the orthophoto covers; a texel is about a pixel in the middle."""
    fields = [np.hypot(view.camera.width, view.camera.height) / max(view.camera.focal) for view in views]
    half = min(settings.ground, 0.8 * float(np.median(fields))) * distance
    focal = float(np.median([max(view.camera.focal) for view in views]))
    limit = int(np.sqrt(settings.most_texels / len(views)))
    cells = int(np.clip(1.8 * half / distance * focal, 128, min(limit, 1000)))
    return OrthoGrid(plane=plane, half=half, cells=cells)


def first_footprint(grid: OrthoGrid, points: Points, distance: float, settings: SupportSettings) -> Texels32:
    """Return where the object seems to stand, 1 there: below the sparse points above the support."""
    local = grid.plane.local(points)
    radius = np.hypot(local[:, 0], local[:, 1])
    above = local[(local[:, 2] > settings.above * distance) & (radius < settings.near * distance), :2]
    mask = np.zeros((grid.cells, grid.cells), np.uint8)
    if len(above) >= 20:
        low, high = np.percentile(above, [2.0, 98.0], axis=0)
        inner = above[((above >= low) & (above <= high)).all(axis=1)]
        corners = cv2.convexHull(np.round(grid.texels_of(inner)).astype(np.int32))
        cv2.fillConvexPoly(mask, corners, 1)
        grow = 2 * int(np.ceil(0.02 * distance / grid.texel)) + 1
        mask = np.asarray(cv2.dilate(mask, np.ones((grow, grow), np.uint8)), np.uint8)
    else:
        middle = round(0.5 * grid.cells)
        cv2.circle(mask, (middle, middle), round(settings.first_radius * distance / grid.texel), 1, -1)
    return mask.astype(np.float32)


def _below(grid: OrthoGrid, agreement: Consensus) -> Bool[ndarray, "cells cells"]:
    """Return the texels of the support that are straight below the object."""
    lattice = agreement.lattice
    solid = (agreement.votes > 0.0).reshape(lattice.shape).any(axis=2)
    places = lattice.low[:2] + (np.argwhere(solid) + 0.5) * lattice.spacing
    half = int(np.ceil(0.5 * lattice.spacing / grid.texel))
    covered = np.zeros((grid.cells, grid.cells), dtype=bool)
    for column, row in np.round(grid.texels_of(places)).astype(int):
        covered[max(row - half, 0) : row + half + 1, max(column - half, 0) : column + half + 1] = True
    return covered


def _given(
    small: Sequence[MaskView],
    support: SupportViews,
    ortho: Orthophoto,
    odds: Sequence[Grey32],
    last: OnSupport | None,
    distance: float,
    settings: SupportSettings,
) -> Given:
    hidden = ortho.hidden.astype(np.float32)
    ground = np.maximum(hidden, (ortho.known > 0.0).astype(np.float32))
    learnt = [1.0 - cv2.remap(hidden, texels, None, cv2.INTER_LINEAR) for texels in support.texels]
    beyond = [1.0 - cv2.remap(ground, texels, None, cv2.INTER_LINEAR) for texels in support.texels]
    plane, reach = support.grid.plane, settings.reach * distance
    return Given(
        odds=[_reduced(each, view) for each, view in zip(odds, small, strict=True)],
        known=Known(
            learnt=[_reduced(each, view) for each, view in zip(learnt, small, strict=True)],
            beyond=[_reduced(each, view) for each, view in zip(beyond, small, strict=True)],
        ),
        beliefs=None if last is None else last.agreement.beliefs,
        frame=Frame(origin=plane.origin, axes=plane.axes),
        low=np.array([-reach, -reach, 0.0]),
        high=np.array([reach, reach, 2.0 * reach]),
        focus=np.zeros(3),
    )


def _reduced(values: Grey32, view: MaskView) -> Reduced:
    size = (view.camera.width, view.camera.height)
    return cv2.resize(values, size, interpolation=cv2.INTER_AREA).astype(np.float64)
