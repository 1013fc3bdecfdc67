"""Finds the object in the photographs of a capture: above its support where there is one, else by agreement.

The result is a `Workspace`; `final.final_mask` draws the mask of each photograph from it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial

import cv2
import numpy as np

from lambent_capture.arrays import Region, Texels32, Vector
from lambent_capture.masks.consensus import ConsensusSettings, MaskView
from lambent_capture.masks.estimate import EstimateSettings, agreed_masks, consistency_of, middle_of
from lambent_capture.masks.final import preview_masks
from lambent_capture.masks.lattice import SCENE
from lambent_capture.masks.motion import SIDE as MOTION_SIDE
from lambent_capture.masks.motion import find_motion
from lambent_capture.masks.on_support import SupportSettings, find_on_support, first_footprint, ortho_grid
from lambent_capture.masks.orthophoto import SupportViews, look_at_support
from lambent_capture.masks.photograph import Photograph, Progress, SparsePoints
from lambent_capture.masks.plane_height import best_height
from lambent_capture.masks.support_plane import PlaneSettings, SupportPlane, find_support
from lambent_capture.masks.triangulate import triangulate
from lambent_capture.masks.workspace import Workspace


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
    weak_reach: float = 0.7
    """Four fifths of the points on a support reach so far, as a share of half the pictures' diagonal, or it
    may be a part of the object, and masks without it are tried as well."""
    standing: tuple[tuple[float, float], ...] = ((1.2, 20.0),)
    """Votes that what is below the object is the object, tried one after the other (`standing`)."""
    clear: float = 0.02
    """How much better than those before it a candidate's masks must agree."""
    enough: float = 0.93
    """Agreement of the masks from which on no further candidate is tried."""
    plane: PlaneSettings = field(default_factory=PlaneSettings)
    support: SupportSettings = field(default_factory=SupportSettings)
    plain: EstimateSettings = field(default_factory=EstimateSettings)


def find_object(
    photographs: Sequence[Photograph],
    points: SparsePoints | None,
    settings: FindSettings,
    progress: Progress = lambda phase, done, total: None,
    *,
    still_background: bool = False,
) -> Workspace | str:
    """Return where the object is in each photograph, or why cameras like these cannot be compared.

    Where nothing was found, `Workspace.reason` says why; a person's marks may still show where it is.
    `points` are sparse points of the scene, with which the support is found; without them they are
    triangulated. With `still_background` the object turned before a camera that stood still: what did not
    move is not the object.
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
    candidates: list[Callable[[], Workspace | None]] = []
    moved = _moved(views) if still_background else None
    if plane is not None:
        support, footprint = _support(plane, views, points, centre, distance, settings, progress)
        start = _Start(photographs, support, footprint, centre, distance, settings.compare_side, moved)
        kinds = [settings.support, *(settings.support.standing(*votes) for votes in settings.standing)]
        candidates.extend(partial(_above, start, kind) for kind in kinds)
    is_weak = plane is not None and plane.reach < settings.weak_reach * _field(photographs) * distance
    # Before a camera that stood still all views agree best on what never moved.
    if plane is None or (is_weak and moved is None):
        candidates.append(lambda: _by_agreement(photographs, views, centre, distance, settings))
    best, most = None, -1.0
    for number, make in enumerate(candidates):
        progress("comparing the views", number, len(candidates))
        work = make()
        if work is None or (best is not None and work.reason):
            continue
        overlap = agreement_of(work, settings.plain)
        if best is None or overlap > most + settings.clear:
            best, most = work, overlap
        if most >= settings.enough:
            break
    progress("comparing the views", len(candidates), len(candidates))
    return best if best is not None else _by_agreement(photographs, views, centre, distance, settings)


def agreement_of(work: Workspace, settings: EstimateSettings) -> float:
    """Return the median overlap of preview masks with what the others make of them, 0..1."""
    if work.reason:
        return 0.0
    masks = [mask.astype(np.float64) for mask in preview_masks(work)]
    views = [work.view(number) for number in range(len(masks))]
    return float(np.median(consistency_of(masks, views, work.centre, work.distance, settings).overlap))


def _field(photographs: Sequence[Photograph]) -> float:
    """Return half the diagonal of the pictures at depth 1, median."""
    cameras = [photograph.camera for photograph in photographs]
    return float(np.median([0.5 * np.hypot(c.width, c.height) / max(c.focal) for c in cameras]))


def _support(
    plane: SupportPlane,
    views: Sequence[MaskView],
    points: SparsePoints,
    centre: Vector,
    distance: float,
    settings: FindSettings,
    progress: Progress,
) -> tuple[SupportViews, Texels32]:
    plane = best_height(plane, views, distance)
    grid = ortho_grid(plane, views, distance, settings.support)
    footprint = first_footprint(grid, points.xyz, distance, settings.support)
    return look_at_support(views, grid, progress), footprint


@dataclass(frozen=True, slots=True)
class _Start:
    photographs: Sequence[Photograph]
    support: SupportViews
    footprint: Texels32
    centre: Vector
    distance: float
    side: int
    """At which views are compared, pixels."""
    moved: list[Region] | None = None
    """Where each photograph shows something that moved before a camera that stood still."""


def _above(start: _Start, chosen: SupportSettings) -> Workspace | None:
    views = start.support.views
    small = [view.averaged(start.side) for view in views]
    seen = find_on_support(
        small, start.support, start.footprint, start.centre, start.distance, chosen, start.moved
    )
    if seen is None:
        return None
    given, agreement = seen.given, seen.agreement
    return Workspace(
        names=tuple(view.name for view in views),
        cameras=tuple(photograph.camera for photograph in start.photographs),
        pictures=tuple(view.image_srgb for view in views),
        support_odds=tuple(odds.astype(np.float16) for odds in seen.odds),
        learnt=tuple(each.astype(np.float32) for each in given.known.learnt or ()),
        beyond=tuple(each.astype(np.float32) for each in given.known.beyond or ()),
        beliefs=tuple(each.astype(np.float32) for each in agreement.beliefs),
        priors=tuple(each.astype(np.float32) for each in agreement.priors),
        frame=given.frame,
        low=given.low,
        high=given.high,
        found_low=agreement.lattice.low,
        found_high=agreement.lattice.low + np.array(agreement.lattice.shape) * agreement.lattice.spacing,
        centre=start.centre,
        distance=start.distance,
        has_support=True,
        rounds=chosen.rounds,
    )


def _by_agreement(
    photographs: Sequence[Photograph],
    views: Sequence[MaskView],
    centre: Vector,
    distance: float,
    settings: FindSettings,
) -> Workspace:
    estimate = agreed_masks(views, settings.plain)
    half = np.full(3, settings.support.reach * distance)
    if isinstance(estimate, str):
        beliefs = tuple(np.zeros((view.camera.height, view.camera.width), np.float32) for view in views)
    else:
        beliefs = tuple(each.astype(np.float32) for each in estimate.coverages)
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
        rounds=ConsensusSettings(),
        reason=estimate if isinstance(estimate, str) else "",
    )


def _moved(views: Sequence[MaskView]) -> list[Region] | None:
    """Return where views of a camera that stood still may show what turned, or None if nothing tells.

    That is the convex hull of all that ever changed: a part that has the same colour from all sides changes
    nothing where it always is.
    """
    motion = find_motion([view.averaged(MOTION_SIDE).image_srgb for view in views])
    if motion is None:
        return None
    changed = np.any(motion.masks, axis=0)
    hull = cv2.convexHull(np.argwhere(changed)[:, ::-1].astype(np.int32))
    swept = cv2.fillConvexPoly(changed.astype(np.uint8), hull, 1)
    sizes = [(view.camera.width, view.camera.height) for view in views]
    return [cv2.resize(swept, size, interpolation=cv2.INTER_NEAREST) > 0 for size in sizes]
