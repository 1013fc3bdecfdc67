"""Puts the support exactly where photographs agree on it: a sweep over heights.

Sparse points on a plain support are few and may be off; its faint pattern still shows from
photograph to photograph at the right height only.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Float
from numpy import ndarray

from lambent_capture.arrays import Grey32
from lambent_capture.masks.consensus import MaskView
from lambent_capture.masks.plane_maps import NOWHERE, OrthoGrid, seen_pixels
from lambent_capture.masks.support_plane import SupportPlane


@dataclass(frozen=True, kw_only=True, slots=True)
class HeightSettings:
    """The sweep; lengths are shares of the cameras' distance."""

    reach: float = 0.03
    """How far up and down the plane is moved."""
    step: float = 0.0025
    half: float = 0.3
    """Half the side of the square of the support that is compared."""
    views: int = 14
    """Compared at most."""
    cells: int = 320
    gain: float = 0.02
    """How much better, in mean correlation, another height must be than that of the points."""


def best_height(
    plane: SupportPlane, views: Sequence[MaskView], distance: float, settings: HeightSettings | None = None
) -> SupportPlane:
    """Return `plane` moved along its normal to where the views agree best; unmoved where none is better."""
    settings = settings or HeightSettings()
    chosen = [views[round(i)] for i in np.linspace(0, len(views) - 1, min(settings.views, len(views)))]
    details = [_detail(view) for view in chosen]
    offsets = np.arange(-settings.reach, settings.reach + 1e-9, settings.step)
    scores = np.array(
        [_agreement(_moved(plane, each * distance), chosen, details, distance, settings) for each in offsets]
    )
    best, kept = int(scores.argmax()), int(np.abs(offsets).argmin())
    if scores[best] < scores[kept] + settings.gain:
        return plane
    shift = offsets[best]
    if 0 < best < len(offsets) - 1:
        left, middle, right = scores[best - 1 : best + 2]
        shift += 0.5 * settings.step * (left - right) / min(left - 2.0 * middle + right, -1e-9)
    return _moved(plane, float(shift) * distance)


def _moved(plane: SupportPlane, height: float) -> SupportPlane:
    return replace(plane, origin=plane.origin + height * plane.normal)


def _detail(view: MaskView) -> Grey32:
    """Return the fine contrast of a picture, which exposure and shading leave alone."""
    grey = np.log1p(cv2.cvtColor(view.image_srgb, cv2.COLOR_RGB2GRAY).astype(np.float32))
    return np.asarray(cv2.GaussianBlur(grey, (0, 0), 1.0) - cv2.GaussianBlur(grey, (0, 0), 4.0))


def _agreement(
    plane: SupportPlane,
    views: Sequence[MaskView],
    details: Sequence[Grey32],
    distance: float,
    settings: HeightSettings,
) -> float:
    """Return the mean over views of the correlation of one with the mean of the others, on the plane."""
    grid = OrthoGrid(plane=plane, half=settings.half * distance, cells=settings.cells)
    total = np.zeros((settings.cells, settings.cells), np.float32)
    count = np.zeros_like(total)
    warped = []
    for view, detail in zip(views, details, strict=True):
        pixels = seen_pixels(view.camera, grid)
        shown = (pixels[..., 0] > NOWHERE).astype(np.float32)
        seen = cv2.remap(detail, pixels, None, cv2.INTER_LINEAR) * shown
        warped.append((seen, shown))
        total += seen
        count += shown
    scores = []
    for seen, shown in warped:
        others = np.maximum(count - shown, 1.0)
        mean = (total - seen) / others
        both = (shown > 0) & (count >= 4)
        if both.sum() >= 400:
            scores.append(_correlation(seen[both], mean[both]))
    return float(np.mean(scores)) if scores else 0.0


def _correlation(one: Float[ndarray, " texels"], other: Float[ndarray, " texels"]) -> float:
    # Large values are edges of things that stand on the support; a few must not decide.
    limit = 3.0 * np.median(np.abs(one)) + 1e-6
    one = np.clip(one, -limit, limit)
    limit = 3.0 * np.median(np.abs(other)) + 1e-6
    other = np.clip(other, -limit, limit)
    return float((one * other).mean() / np.sqrt((one * one).mean() * (other * other).mean() + 1e-12))
