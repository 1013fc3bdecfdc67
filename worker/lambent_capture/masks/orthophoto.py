"""The support as seen from straight above, put together from all photographs: the model of the background.

Whatever lies on the support stays where it is in the orthophoto: its pattern, print, and shadows that do not
move. What stands on it is smeared by parallax and is outvoted, as long as enough views see past it. Values
are CIELAB of linear light in which the exposures of the views are evened out.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8
from lambent_core.colour import linear_from_srgb
from numpy import ndarray

from lambent_capture.arrays import Colours32, Reduced, Rgb, Texels32, Vector
from lambent_capture.masks.consensus import MaskView
from lambent_capture.masks.photograph import Progress
from lambent_capture.masks.plane_maps import NOWHERE, OrthoGrid, seen_pixels, seen_texels

_LINEAR = linear_from_srgb(np.arange(256) / 255.0).astype(np.float32)
_SCALE = np.array([2.55, 1.0, 1.0], dtype=np.float32)
_OFFSET = np.array([0.0, 128.0, 128.0], dtype=np.float32)
_MEDIAN_VIEWS = 24
_PATTERN = 0.4
"""Standard deviation of a texel between views for each unit of contrast around it: registration, blur."""
_LEAST_VIEWS = 3
"""Views that must see a texel free for its colour to be known."""


@dataclass(frozen=True, slots=True)
class Orthophoto:
    """Colour of each texel of the support, how far views deviate from it, and where it is known."""

    lab: Float32[ndarray, "cells cells 3"]
    spread: Float32[ndarray, "cells cells 2"]
    """Standard deviations over the views, of L and of chroma."""
    known: Texels32
    """1 where enough views see the support free, 0 where none does."""
    hidden: Bool[ndarray, "cells cells"]
    """Where enough views look, but none sees the support free: what the object stands on."""

    def hide(self, texels: Bool[ndarray, "cells cells"]) -> None:
        """Take back what is known of some texels."""
        self.known[texels], self.hidden[texels] = 0.0, True


@dataclass(slots=True)
class SupportViews:
    """The views as they see the support: what `orthophoto` and the comparison need, computed once."""

    grid: OrthoGrid
    views: list[MaskView]
    gains: Float[ndarray, "views 3"]
    """What the linear light of each view is multiplied by to be in the exposure and white of the others."""
    texels: list[Float32[ndarray, "height width 2"]] = field(default_factory=list)
    maps: list[tuple[ndarray, ndarray]] = field(default_factory=list)
    warped: list[UInt8[ndarray, "cells cells 3"]] = field(default_factory=list)
    """CIELAB of each view on the support, as `cv2` keeps it in bytes; L = 0 outside of the picture."""

    def lab(self, view: int) -> Colours32:
        """Return a view in CIELAB, exposures evened out."""
        return lab_with_gain(self.views[view].image_srgb, self.gains[view])


def lab_with_gain(image_srgb: Rgb, gain: Vector) -> Colours32:
    """Return CIELAB of a picture whose linear light is multiplied by `gain`."""
    table = _LINEAR[:, None] * gain.astype(np.float32)
    light = cv2.LUT(image_srgb, table[:, None])
    return np.asarray(cv2.cvtColor(light, cv2.COLOR_LRGB2Lab))


def colours_of_bytes(coded: UInt8[ndarray, "*shape 3"]) -> Float32[ndarray, "*shape 3"]:
    """Return CIELAB of colours as `SupportViews.warped` keeps them."""
    return np.asarray((coded.astype(np.float32) - _OFFSET) / _SCALE)


def look_at_support(
    views: Sequence[MaskView], grid: OrthoGrid, progress: Progress = lambda phase, done, total: None
) -> SupportViews:
    """Return the views laid on the support, with their exposures evened out there."""
    support = SupportViews(grid, list(views), np.ones((len(views), 3)))
    plain = []
    for number, view in enumerate(views):
        support.texels.append(seen_texels(view.camera, grid))
        pixels = seen_pixels(view.camera, grid)
        support.maps.append(cv2.convertMaps(pixels, None, cv2.CV_16SC2))
        # Averaged over about a texel's surroundings, so that pattern finer than the grid does not alias.
        smooth = cv2.GaussianBlur(view.image_srgb, (0, 0), 0.7)
        plain.append(_warp(smooth, support.maps[-1]))
        progress("looking at the support", number + 1, len(views))
    support.gains = _even_gains(plain)
    for number, picture in enumerate(plain):
        lab = lab_with_gain(picture, support.gains[number])
        coded = np.clip(np.round(lab * _SCALE + _OFFSET), 0, 255).astype(np.uint8)
        shown = support.maps[number][0][..., 0] > NOWHERE / 2
        coded[..., 0] = np.where(shown, np.maximum(coded[..., 0], 1), 0)
        support.warped.append(coded)
    return support


def build(support: SupportViews, beliefs: Sequence[Reduced] | None) -> Orthophoto:
    """Return the orthophoto from what is not believed to be the object; from everything without `beliefs`.

    Source of the robust mean: Tukey's biweight, two steps from the median of up to 24 views.
    """
    weights = [free_of_object(support, number, beliefs) for number in range(len(support.views))]
    centre = _median(support, weights)
    spread = np.full((*centre.shape[:2], 2), 6.0, dtype=np.float32)
    known = np.zeros(centre.shape[:2], dtype=np.float32)
    for _ in range(2):
        total = np.full(centre.shape[:2], 1e-6, dtype=np.float32)
        first = np.zeros_like(centre)
        second = np.zeros_like(spread)
        for picture, weight in zip(support.warped, weights, strict=True):
            off = (picture.astype(np.float32) - _OFFSET) / _SCALE - centre
            square = np.stack([off[..., 0] ** 2, 0.5 * (off[..., 1] ** 2 + off[..., 2] ** 2)], axis=-1)
            z = square[..., 0] / (4.0 * spread[..., 0]) ** 2 + square[..., 1] / (4.0 * spread[..., 1]) ** 2
            own = weight * np.clip(1.0 - z, 0.0, 1.0) ** 2
            total += own
            first += own[..., None] * off
            second += own[..., None] * square
        shift = first / total[..., None]
        centre = centre + shift
        variance = second / total[..., None]
        variance[..., 0] -= shift[..., 0] ** 2
        variance[..., 1] -= 0.5 * (shift[..., 1] ** 2 + shift[..., 2] ** 2)
        spread = 1.15 * np.sqrt(np.maximum(variance, 0.0)) + np.float32(0.4)
        known = total
    looked = np.sum([picture[..., 0] > 0 for picture in support.warped], axis=0)
    known = np.clip(known / _LEAST_VIEWS, 0.0, 1.0)
    spread = _plausible(centre, spread, known)
    return Orthophoto(centre, spread, known, (looked >= _LEAST_VIEWS) & (known < 0.5))


def _plausible(
    lab: Float32[ndarray, "cells cells 3"], spread: Float32[ndarray, "cells cells 2"], known: Texels32
) -> Float32[ndarray, "cells cells 2"]:
    """Return spreads no larger than elsewhere on the support, but where its own pattern has contrast.

    Where many views show the object in front of a texel, it widens the spread and would hide behind it.
    """
    certain = known > 0.9
    if not certain.any():
        return spread
    mean = cv2.blur(lab, (5, 5))
    square = np.maximum(cv2.blur(lab**2, (5, 5)) - mean**2, 0.0)
    contrast = np.sqrt(np.dstack([square[..., 0], 0.5 * (square[..., 1] + square[..., 2])]))
    usual = np.median(spread[certain], axis=0)
    return np.minimum(spread, 1.3 * usual + _PATTERN * contrast).astype(np.float32)


def _warp(picture: ndarray, maps: tuple[ndarray, ndarray]) -> ndarray:
    return np.asarray(cv2.remap(picture, *maps, cv2.INTER_LINEAR))


def free_of_object(support: SupportViews, number: int, beliefs: Sequence[Reduced] | None) -> Texels32:
    """Return 1 for texels that a view shows free of what is believed to be the object, else 0."""
    shown = (support.warped[number][..., 0] > 0).astype(np.float32)
    if beliefs is None:
        return shown
    camera = support.views[number].camera
    belief = cv2.resize(beliefs[number].astype(np.float32), (camera.width, camera.height))
    free = _warp((belief < 0.5).astype(np.float32), support.maps[number])
    return shown * np.clip(2.0 * free - 1.0, 0.0, 1.0)


def _even_gains(pictures: Sequence[UInt8[ndarray, "cells cells 3"]]) -> Float[ndarray, "views 3"]:
    """Return what evens out exposure and white balance: median ratios to the median picture.

    Gains beyond a factor of four say that nothing is shared; they become 1.
    """
    step = 6
    small = np.stack([picture[::step, ::step] for picture in pictures]).astype(np.float32)
    shown = small.max(axis=-1) > 8
    light = np.where((shown & (small.max(axis=-1) < 250))[..., None], _LINEAR[small.astype(np.uint8)], np.nan)
    gains = np.ones((len(pictures), 3))
    usable = np.isfinite(light[..., 1]).sum(axis=0) >= _LEAST_VIEWS
    if not usable.any():
        return gains
    light = light[:, usable]
    for _ in range(3):
        reference = _median_without_nan(light * gains[:, None])
        for number in range(len(pictures)):
            ratios = reference / np.maximum(light[number], 1e-4)
            if np.isfinite(ratios[:, 1]).sum() >= 50:
                gains[number] = np.nanmedian(ratios, axis=0)
        gains /= np.exp(np.log(gains).mean(axis=0))
    return np.where((gains > 0.25) & (gains < 4.0), gains, 1.0)


def _median_without_nan(values: Float[ndarray, "views texels 3"]) -> Float[ndarray, "texels 3"]:
    """Return `np.nanmedian` over the views, the lower of two middle ones; much faster for few views."""
    ordered = np.sort(values, axis=0)
    middle = np.maximum(np.isfinite(values).sum(axis=0) - 1, 0) // 2
    return np.take_along_axis(ordered, middle[None], axis=0)[0]


def _median(support: SupportViews, weights: Sequence[Texels32]) -> Float32[ndarray, "cells cells 3"]:
    """Return the median colour of each texel over up to 24 views that see it free."""
    step = max(1, -(-len(weights) // _MEDIAN_VIEWS))
    chosen = range(0, len(weights), step)
    cells = support.grid.cells
    result = np.zeros((cells, cells, 3), dtype=np.float32)
    rows = 64
    for start in range(0, cells, rows):
        part = slice(start, start + rows)
        stack = np.stack([support.warped[number][part] for number in chosen])
        free: Bool[ndarray, "views rows cells"] = np.stack([weights[number][part] > 0.5 for number in chosen])
        stack = np.where(free[..., None], stack, 255)
        stack.sort(axis=0)
        middle = np.maximum(free.sum(axis=0) - 1, 0) // 2
        median = np.take_along_axis(stack, middle[None, ..., None], axis=0)[0]
        result[part] = (median.astype(np.float32) - _OFFSET) / _SCALE
    return result
