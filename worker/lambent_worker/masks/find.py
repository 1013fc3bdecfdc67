"""Finds the object in the photographs of a capture: above its support where there is one, else by agreement.

The result is a `Workspace`; `final.final_mask` draws the mask of each photograph from it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
from jaxtyping import Float
from numpy import ndarray

from lambent_worker.masks.consensus import MaskView, prepare
from lambent_worker.masks.estimate import EstimateSettings, agreed_masks, middle_of
from lambent_worker.masks.lattice import SCENE
from lambent_worker.masks.on_support import (
    OnSupport,
    SupportSettings,
    find_on_support,
    first_footprint,
    ortho_grid,
)
from lambent_worker.masks.orthophoto import look_at_support
from lambent_worker.masks.photograph import Photograph, Progress, SparsePoints
from lambent_worker.masks.plane_height import best_height
from lambent_worker.masks.support_plane import PlaneSettings, SupportPlane, find_support
from lambent_worker.masks.triangulate import triangulate
from lambent_worker.masks.workspace import Workspace


@dataclass(frozen=True, kw_only=True, slots=True)
class FindSettings:
    """Sizes at which the object is looked for."""

    evidence_side: int = 640
    """Longer side at which views are compared with the support, pixels; reduced for many views."""
    full_views: int = 60
    """With more views, pictures get smaller so that all have as many pixels as so many."""
    compare_side: int = 192
    """Longer side at which views are compared with each other."""
    plain_side: int = 512
    """Longer side for captures without a support."""
    plane: PlaneSettings = field(default_factory=PlaneSettings)
    support: SupportSettings = field(default_factory=SupportSettings)
    plain: EstimateSettings = field(default_factory=EstimateSettings)


def find_object(
    photographs: Sequence[Photograph],
    points: SparsePoints | None,
    settings: FindSettings,
    progress: Progress = lambda phase, done, total: None,
) -> Workspace | str:
    """Return where the object is in each photograph, or why cameras like these cannot be compared.

    Where nothing was found, `Workspace.reason` says why; a person's marks may still show where it is.
    `points` are sparse points of the scene, with which the support is found; without them they are
    triangulated.
    """
    middle = middle_of(photographs)
    if isinstance(middle, str):
        return middle
    centre, distance = middle
    if points is None:
        points = triangulate(photographs, centre, progress=progress)
    side = round(settings.evidence_side * min(1.0, np.sqrt(settings.full_views / len(photographs))))
    positions = np.array([photograph.camera.position for photograph in photographs])
    plane = find_support(points.xyz, positions, centre, distance, settings.plane)
    if plane is None:
        side = min(side, settings.plain_side)
    views = []
    for number, photograph in enumerate(photographs):
        views.append(photograph.reduced(side))
        progress("reading photographs", number + 1, len(photographs))
    if plane is not None:
        found = _above(plane, views, points, centre, distance, settings, progress)
        if found is not None:
            return _workspace_above(photographs, views, found, centre, distance)
    return _by_agreement(photographs, views, centre, distance, settings, progress)


def _above(
    plane: SupportPlane,
    views: Sequence[MaskView],
    points: SparsePoints,
    centre: Float[ndarray, "3"],
    distance: float,
    settings: FindSettings,
    progress: Progress,
) -> OnSupport | None:
    plane = best_height(plane, views, distance)
    grid = ortho_grid(plane, views, distance, settings.support)
    count = _Counter("looking at the support", len(views), progress)
    support = look_at_support(views, grid, count.step)
    small = [_smaller(view, settings.compare_side) for view in views]
    footprint = first_footprint(grid, points.xyz, distance, settings.support)
    count = _Counter("comparing the views", settings.support.turns, progress)
    return find_on_support(
        views,
        small,
        support,
        footprint,
        centre,
        distance,
        settings.support,
        prepare(small, edges=False),
        count.step,
    )


def _workspace_above(
    photographs: Sequence[Photograph],
    views: Sequence[MaskView],
    found: OnSupport,
    centre: Float[ndarray, "3"],
    distance: float,
) -> Workspace:
    given = found.given
    return Workspace(
        names=tuple(view.name for view in views),
        cameras=tuple(photograph.camera for photograph in photographs),
        pictures=tuple(view.image_srgb for view in views),
        support_odds=tuple(odds.astype(np.float16) for odds in found.odds),
        learnt=tuple(each.astype(np.float32) for each in given.known.learnt or ()),
        beyond=tuple(each.astype(np.float32) for each in given.known.beyond or ()),
        beliefs=tuple(each.astype(np.float32) for each in found.agreement.beliefs),
        priors=tuple(each.astype(np.float32) for each in found.agreement.priors),
        frame=given.frame,
        low=given.low,
        high=given.high,
        found_low=found.agreement.lattice.low,
        found_high=found.agreement.lattice.low
        + np.array(found.agreement.lattice.shape) * found.agreement.lattice.spacing,
        centre=centre,
        distance=distance,
        has_support=True,
    )


def _by_agreement(
    photographs: Sequence[Photograph],
    views: Sequence[MaskView],
    centre: Float[ndarray, "3"],
    distance: float,
    settings: FindSettings,
    progress: Progress,
) -> Workspace:
    progress("comparing the views", 0, 1)
    found = agreed_masks(views, settings.plain)
    progress("comparing the views", 1, 1)
    half = np.full(3, settings.support.reach * distance)
    if isinstance(found, str):
        beliefs = tuple(np.zeros((view.camera.height, view.camera.width), np.float32) for view in views)
    else:
        beliefs = tuple(each.astype(np.float32) for each in found.coverages)
    return Workspace(
        names=tuple(view.name for view in views),
        cameras=tuple(photograph.camera for photograph in photographs),
        pictures=tuple(view.image_srgb for view in views),
        support_odds=tuple(np.zeros(each.shape, np.float16) for each in beliefs),
        learnt=tuple(np.ones(each.shape, np.float32) for each in beliefs),
        beyond=tuple(np.zeros(each.shape, np.float32) for each in beliefs),
        beliefs=beliefs,
        priors=tuple(np.float32(12.0) * (each - np.float32(0.5)) for each in beliefs),
        frame=SCENE,
        low=centre - half,
        high=centre + half,
        found_low=centre - half,
        found_high=centre + half,
        centre=centre,
        distance=distance,
        has_support=False,
        reason=found if isinstance(found, str) else "",
    )


def _smaller(view: MaskView, side: int) -> MaskView:
    scale = min(1.0, side / max(view.camera.width, view.camera.height))
    size = (max(1, round(scale * view.camera.width)), max(1, round(scale * view.camera.height)))
    picture = cv2.resize(view.image_srgb, size, interpolation=cv2.INTER_AREA)
    return MaskView(view.name, picture, view.camera.resized(*size))


class _Counter:
    """Tells progress one by one."""

    def __init__(self, phase: str, total: int, progress: Progress) -> None:
        self._phase, self._total, self._progress, self._done = phase, total, progress, 0

    def step(self) -> None:
        self._done += 1
        self._progress(self._phase, self._done, self._total)
