"""Agreement of each silhouette with all others, by the part of it that their common hull explains.

Two statements hold for any object and any number of views, and are tested: the hull of the other views
explains every pixel of a correct silhouette, and a correct silhouette never cuts away what another view
shows.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool
from numpy import ndarray
from scipy import ndimage

from lambent_capture.arrays import Points, Region
from lambent_capture.checks.hull import HullVotes, footprint, grown
from lambent_capture.checks.sphere import unit_directions
from lambent_capture.scenes.silhouettes import Silhouette

_SCALES = (0.85, 0.9, 0.95, 1.0, 1.05, 1.1, 1.18)
_MAX_PART = 0.01
"""Specks are islands of at most this share of the silhouette."""
_MISSED_WORTH_A_LOOK = 0.01
_MAX_LOOKS = 12
"""Views, the worst first, for which what they cut away is projected into all others."""
_NEIGHBOURS, _NEIGHBOUR_DEG = 3, 35.0
"""With fewer views than this within this angle, a hole in a mask may be one that only this view looks
through."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Agreement:
    """Agreement of a silhouette with the other views."""

    unexplained_share: float
    """Pixels of the silhouette that no cell of the others' hull explains, of its area."""
    missed_share: float = 0.0
    """Cells of the others' hull that are visible outside the silhouette, of all visible ones. Large without
    any fault where views are few."""
    carved_share: float = 0.0
    """Share of another view's silhouette that only this silhouette cuts away; the
    largest over all others. 0 where `missed_share` is too small to matter."""
    hole_share: float = 0.0
    """Holes of the mask that no other view sees through, of its area; 0 where no view is near enough."""
    speck_share: float = 0.0
    """Small islands of the mask that are not explained, of its area."""
    num_specks: int = 0
    moved_share: float = 1.0
    """Disagreement that remains after the best shift and scale of the silhouette: small if
    the camera is wrong and not the mask."""


def compare(
    hull: HullVotes, silhouettes: Sequence[Silhouette], *, tolerated: int, unexplained_limit: float
) -> list[Agreement]:
    """Return the agreement of each silhouette with the hull of the others.

    What is not explained is measured against a generous hull (`tolerated` views may contradict a cell), the
    rest against a strict one (none may, and views that are themselves in doubt do not vote).
    """
    views = range(len(silhouettes))
    against = hull.against()
    explained = [
        footprint(silhouettes[v].camera, hull.points[hull.cells(against, tolerated, v)], hull.spacing)
        for v in views
    ]
    unexplained = [_share(silhouettes[v].mask & ~explained[v], silhouettes[v].mask) for v in views]
    trusted = np.array(unexplained) <= unexplained_limit
    if trusted.sum() < max(2, len(silhouettes) // 2):
        trusted[:] = True
    against = hull.against(trusted)
    # The cells on which all trusted views but one agree; a view in doubt has no vote to subtract.
    cores = [hull.cells(against, 0, v if trusted[v] else None) for v in views]
    dense = _have_neighbours(hull, silhouettes)
    agreements = [
        _look(silhouettes[v], hull.points[cores[v]], explained[v], unexplained[v], dense=bool(dense[v]))
        for v in views
    ]
    suspects = [v for v in views if trusted[v] and agreements[v].missed_share > _MISSED_WORTH_A_LOOK]
    for v in sorted(suspects, key=lambda v: -agreements[v].missed_share)[:_MAX_LOOKS]:
        agreements[v] = replace(agreements[v], carved_share=_carved(hull, silhouettes, v, cores[v], trusted))
    for v in views:
        if (
            max(agreements[v].unexplained_share, agreements[v].carved_share, agreements[v].hole_share)
            > 0.5 * unexplained_limit
        ):
            moved = moved_share(silhouettes[v], hull.points[cores[v]], hull.spacing)
            agreements[v] = replace(agreements[v], moved_share=moved)
    return agreements


def _share(part: Region, whole: Region) -> float:
    return float(part.sum() / max(whole.sum(), 1))


def _have_neighbours(hull: HullVotes, silhouettes: Sequence[Silhouette]) -> Bool[ndarray, " views"]:
    positions = np.array([each.camera.position for each in silhouettes])
    directions = unit_directions(positions, hull.points.mean(axis=0))
    near = directions @ directions.T >= np.cos(np.radians(_NEIGHBOUR_DEG))
    return near.sum(axis=1) - 1 >= _NEIGHBOURS


def _look(
    silhouette: Silhouette, core: Points, explained: Region, unexplained_share: float, *, dense: bool
) -> Agreement:
    mask = silhouette.mask
    shown, index, _ = silhouette.camera.pixels(core)
    beside = shown & ~grown(mask, 2).ravel()[index]
    missed = np.zeros(mask.size, dtype=bool)
    missed[index[shown]] = True
    missed = missed.reshape(mask.shape) & ~mask
    num_specks, speck_area = _specks(mask, mask & ~explained)
    holes = ndimage.binary_fill_holes(mask) & ~mask
    return Agreement(
        unexplained_share=unexplained_share,
        missed_share=float(beside.sum() / max(shown.sum(), 1)),
        hole_share=_share(missed & holes, mask) if dense else 0.0,
        speck_share=speck_area / max(int(mask.sum()), 1),
        num_specks=num_specks,
    )


def _specks(mask: Region, unexplained: Region) -> tuple[int, int]:
    """Return number and area in pixels of the small islands of the mask that the hull does not explain.

    Small holes are not counted: a lattice has some that only one view looks through.
    """
    labels, number = ndimage.label(mask)
    if not number or not unexplained.any():
        return 0, 0
    sizes = np.bincount(labels.ravel(), minlength=number + 1)
    limit = max(_MAX_PART * int(mask.sum()), 4.0)
    small = [part for part in np.unique(labels[unexplained]) if part and sizes[part] <= limit]
    return len(small), int(sizes[small].sum())


def _carved(
    hull: HullVotes,
    silhouettes: Sequence[Silhouette],
    view: int,
    others: Bool[ndarray, " points"],
    trusted: Bool[ndarray, " views"],
) -> float:
    """Return the largest share of another silhouette that nothing explains once `view` has cut."""
    own = silhouettes[view]
    shown, index, _ = own.camera.pixels(hull.points)
    # Two pixels are forgiven, so that what is cut away is more than rounding.
    cut = others & shown & ~grown(own.mask, 2).ravel()[index]
    left, gone = hull.points[others & ~cut], hull.points[cut]
    worst = 0.0
    for other, silhouette in enumerate(silhouettes):
        if other == view or not trusted[other]:
            continue
        lost = footprint(silhouette.camera, gone, hull.spacing) & silhouette.mask
        if lost.any():
            lost &= ~footprint(silhouette.camera, left, hull.spacing)
            worst = max(worst, _share(lost, silhouette.mask))
    return worst


def moved_share(silhouette: Silhouette, core: Points, spacing: float) -> float:
    """Return the share of the disagreement that remains after the best shift and scale of the silhouette.

    Near 0, a turned or displaced camera explains everything; 1 means that it explains nothing.
    """
    mask = silhouette.mask
    # Cells are wider than their centres and were found with pixel accuracy: the true outline lies within.
    wide = footprint(silhouette.camera, core, spacing)
    wanted = ndimage.binary_erosion(wide, iterations=1, border_value=1)
    if not wanted.any() or not mask.any():
        return 1.0
    before = best = _disagreement(mask, wanted, wide)
    spectrum = np.conj(np.fft.rfft2(wanted.astype(np.float32)))
    for scale in _SCALES:
        scaled = _scaled(mask, scale)
        overlap = np.fft.irfft2(np.fft.rfft2(scaled.astype(np.float32)) * spectrum, s=mask.shape)
        row, column = np.unravel_index(int(overlap.argmax()), overlap.shape)
        moved = np.roll(scaled, (-int(row), -int(column)), axis=(0, 1))
        best = min(best, _disagreement(moved, wanted, wide))
    return best / before if before > 0.0 else 1.0


def _disagreement(mask: Region, wanted: Region, wide: Region) -> float:
    """Return the pixels in one mask only, a rim of a pixel forgiven, over the area wanted."""
    differing = (mask & ~wide).sum() + (wanted & ~grown(mask, 2)).sum()
    return float(differing / wanted.sum())


def _scaled(mask: Region, scale: float) -> Region:
    if scale == 1.0:
        return mask
    height, width = mask.shape
    middle = np.array([0.5 * (height - 1), 0.5 * (width - 1)])
    values = ndimage.affine_transform(
        mask.astype(np.float32), np.array([1.0 / scale] * 2), offset=middle - middle / scale, order=1
    )
    return values >= 0.5
