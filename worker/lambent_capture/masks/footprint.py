"""Takes away from the unknown footprint of the object what some views do see free of it.

Where no view was believed to see the support, it may still be seen: from the rim of what is known inwards, a
texel is support where most views that are not believed to show the object there show the same, and something
like what its neighbours look like. Shadows that get deeper towards the object are followed, since only near
neighbours are compared. What remains is what no view sees free: there every view shows the object, each
another side of it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32
from numpy import ndarray

from lambent_capture.arrays import Cells, Reduced, Texels32
from lambent_capture.masks.evidence import TABLE_VOLUME, colour_cells
from lambent_capture.masks.orthophoto import (
    Orthophoto,
    SupportViews,
    colours_of_bytes,
    free_of_object,
)
from lambent_capture.masks.prediction import ANY_COLOUR


@dataclass(frozen=True, kw_only=True, slots=True)
class UncoverSettings:
    """How the footprint shrinks."""

    rounds: int = 12
    """Layers that are taken off at most."""
    layer: float = 0.008
    """Thickness of a layer, as a share of the cameras' distance."""
    share: float = 0.7
    """Least share that must agree of the views that are not believed to show the object there."""
    least_views: int = 3
    tolerance: float = 2.0
    """How far colours may be from those of the neighbours, in standard deviations of these; and from each
    other, in the support's usual deviation between views."""
    clear: float = 2.0
    """How much more likely colours must be the support's than the object's, log odds."""
    widened: float = 1.3
    """How much more a texel may differ from its neighbours than they differ between views."""


def uncovered(
    support: SupportViews,
    ortho: Orthophoto,
    beliefs: Sequence[Reduced],
    objects: Cells,
    distance: float,
    settings: UncoverSettings | None = None,
) -> Orthophoto:
    """Return the orthophoto with everything that views see free of the object known.

    `beliefs` say where each view shows the object; `objects` is the table of the object's colours
    (`evidence.ColourModel`): what may as well be the object stays unknown.
    """
    settings = settings or UncoverSettings()
    lab, spread = ortho.lab.copy(), ortho.spread.copy()
    known, hidden = ortho.known.copy(), ortho.hidden.copy()
    certain = known > 0.9
    if not certain.any():
        return ortho
    usual = settings.tolerance * np.median(spread[certain], axis=0) + 0.5
    free_views = [free_of_object(support, view, beliefs) > 0.5 for view in range(len(support.views))]
    log_objects = np.log(0.5 * objects / TABLE_VOLUME + 0.5 * ANY_COLOUR)
    sigma = max(settings.layer * distance / support.grid.texel, 1.0)
    for _ in range(settings.rounds):
        near, expected, deviation = _surroundings(lab, spread, known, sigma)
        rows, columns = np.nonzero(hidden & (near > 0.1))
        if len(rows) < 5:
            break
        own, sigmas = expected[rows, columns], settings.widened * deviation[rows, columns] + 0.5
        seen = np.stack([picture[rows, columns] for picture in support.warped])
        shown = (seen[..., 0] > 0) & np.stack([free[rows, columns] for free in free_views])
        colours = colours_of_bytes(seen)
        square = ((colours[..., 0] - own[:, 0]) / sigmas[:, 0]) ** 2
        square += ((colours[..., 1:] - own[:, 1:]) ** 2).sum(axis=-1) / sigmas[:, 1] ** 2
        like = _alike(colours, shown & (square < settings.tolerance**2), usual)
        # The density of a normal distribution as wide as the support's usual deviation, at its middle.
        log_support = -np.log(15.7 * usual[0] * usual[1] ** 2 / settings.tolerance**3)
        like &= log_support > log_objects[colour_cells(colours)] + settings.clear
        count = like.sum(axis=0)
        free = count >= np.maximum(settings.least_views, settings.share * shown.sum(axis=0))
        if free.sum() < 5:
            break
        weight = like[:, free, None].astype(np.float32)
        mean = (colours[:, free] * weight).sum(axis=0) / weight.sum(axis=0)
        square = ((colours[:, free] - mean) ** 2 * weight).sum(axis=0) / weight.sum(axis=0)
        places = rows[free], columns[free]
        lab[places] = mean
        spread[places] = np.sqrt(np.stack([square[:, 0], 0.5 * (square[:, 1] + square[:, 2])], axis=-1)) + 0.4
        known[places], hidden[places] = 1.0, False
    return Orthophoto(lab, spread, known, hidden)


def _alike(
    colours: Float32[ndarray, "views texels 3"],
    candidates: Bool[ndarray, "views texels"],
    deviation: Float32[ndarray, " 2"],
) -> Bool[ndarray, "views texels"]:
    """Return which candidates show the colour that most of them show, to `deviation` in L and in chroma."""
    alike = np.zeros_like(candidates)
    most = np.zeros(candidates.shape[1], dtype=np.int64)
    for own, is_candidate in zip(colours, candidates, strict=True):
        off = colours - own
        square = (off[..., 0] / deviation[0]) ** 2 + (off[..., 1:] ** 2).sum(axis=-1) / deviation[1] ** 2
        same = candidates & is_candidate & (square < 1.0)
        count = same.sum(axis=0)
        better = count > most
        alike[:, better] = same[:, better]
        most = np.maximum(most, count)
    return alike


def _surroundings(
    lab: Float32[ndarray, "cells cells 3"],
    spread: Float32[ndarray, "cells cells 2"],
    known: Texels32,
    sigma: float,
) -> tuple[ndarray, ndarray, ndarray]:
    """Return how much is known around each texel, its mean colour and mean spread."""
    weight = (known > 0.5).astype(np.float32)
    near = cv2.GaussianBlur(weight, (0, 0), sigma)
    scale = 1.0 / np.maximum(near, 1e-3)[..., None]
    colours = cv2.GaussianBlur(lab * weight[..., None], (0, 0), sigma) * scale
    deviation = cv2.GaussianBlur(spread * weight[..., None], (0, 0), sigma) * scale
    # Neighbours differ from each other, too, where the support has a pattern.
    square = cv2.GaussianBlur(lab**2 * weight[..., None], (0, 0), sigma) * scale - colours**2
    pattern = np.sqrt(np.maximum(np.dstack([square[..., 0], 0.5 * (square[..., 1] + square[..., 2])]), 0.0))
    return near, colours, np.sqrt(deviation**2 + pattern**2)
