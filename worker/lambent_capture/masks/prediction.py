"""Compares each view with what the support would look like there: what differs stands on the support."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy import ndarray

from lambent_capture.arrays import Cells, Colours32, Grey32
from lambent_capture.masks.evidence import TABLE_VOLUME, colour_cells
from lambent_capture.masks.orthophoto import Orthophoto, SupportViews

ANY_COLOUR = 1.0 / (100.0 * 80.0 * 80.0)
"""Density of the colour of an object about which nothing is known, per CIELAB volume."""


@dataclass(frozen=True, kw_only=True, slots=True)
class PredictionSettings:
    """How colours of the support may deviate from the orthophoto."""

    blur: float = 1.0
    """Standard deviation of the blur under which both are compared, pixels."""
    least_l: float = 1.2
    least_chroma: float = 1.2
    """Least standard deviations of L and of a and b."""
    shadow: float = 0.01
    """Chance that a pixel of the support is in a shadow that is not in the orthophoto."""
    darkest: float = 0.45
    """The deepest shadow, as a share of the lightness L that it takes away."""
    surprise: float = 0.01
    """Chance that a pixel of the support has any colour at all."""
    learnt: float = 0.5
    """Weight of the colours that were learnt of the object."""
    least_odds: float = -4.0
    """Least log odds of a pixel: how sure what looks like the support is the support."""
    limit: float = 4.0
    """Largest log odds of a pixel."""


def support_odds(
    support: SupportViews, ortho: Orthophoto, view: int, objects: Cells | None, settings: PredictionSettings
) -> Grey32:
    """Return the log odds that a pixel does not show the support; 0 where nothing is known of the support.

    Colours of the support are normal around the orthophoto's, or darkened by a shadow, or anything;
    those of the object are anything, or as the table `objects` has them (`evidence.ColourModel`): an object
    that is coloured like its support is not ruled out where it looks like it. Positive is object.
    """
    predicted, deviation, known = _predicted(support, ortho, view, settings)
    own = cv2.GaussianBlur(support.lab(view), (0, 0), settings.blur)
    off = own - predicted
    sigma_l = np.maximum(deviation[..., 0], settings.least_l)
    sigma_c = np.maximum(deviation[..., 1], settings.least_chroma)
    square_c = (off[..., 1] ** 2 + off[..., 2] ** 2) / sigma_c**2
    norm_c = 2.0 * np.pi * sigma_c**2
    plain = np.exp(-0.5 * ((off[..., 0] / sigma_l) ** 2 + square_c)) / (2.5066 * sigma_l * norm_c)
    density = (1.0 - settings.shadow - settings.surprise) * plain
    density += settings.shadow * _shadow_density(own, predicted, sigma_l, sigma_c, settings)
    density += settings.surprise * ANY_COLOUR
    anything = np.float32(ANY_COLOUR)
    if objects is None:
        odds = np.log(anything) - np.log(density)
    else:
        table = (objects / TABLE_VOLUME).astype(np.float32)
        likely = (1.0 - settings.learnt) * anything + settings.learnt * table[colour_cells(support.lab(view))]
        odds = np.log(likely) - np.log(density)
    return (known * np.clip(odds, settings.least_odds, settings.limit)).astype(np.float32)


def _shadow_density(
    own: Colours32, predicted: Colours32, sigma_l: Grey32, sigma_c: Grey32, settings: PredictionSettings
) -> Grey32:
    """Return the density of the support in shadows: any L down to the darkest, chroma in proportion."""
    lightness = np.maximum(predicted[..., 0], 1.0)
    range_l = np.maximum(settings.darkest * lightness, 1.0)
    share = np.clip(own[..., 0] / lightness, 0.0, 1.0)
    a, b = own[..., 1] - share * predicted[..., 1], own[..., 2] - share * predicted[..., 2]
    chroma = np.exp(-0.5 * (a * a + b * b) / sigma_c**2) / (2.0 * np.pi * sigma_c**2)
    drop = lightness - own[..., 0]
    over = np.maximum(np.maximum(-drop, drop - range_l), 0.0)
    return np.asarray(chroma * np.exp(-0.5 * (over / sigma_l) ** 2) / range_l)


def _predicted(
    support: SupportViews, ortho: Orthophoto, view: int, settings: PredictionSettings
) -> tuple[ndarray, ndarray, ndarray]:
    """Return the view of the support alone: colours, standard deviations of L and chroma, and where known."""
    texels = support.texels[view]
    weighted = np.concatenate(
        [np.concatenate([ortho.lab, ortho.spread[..., :1]], -1) * ortho.known[..., None]], -1
    )
    first = cv2.remap(weighted, texels, None, cv2.INTER_LINEAR)
    second = cv2.remap(
        np.dstack([ortho.spread[..., 1] * ortho.known, ortho.known]), texels, None, cv2.INTER_LINEAR
    )
    first = cv2.GaussianBlur(first, (0, 0), settings.blur)
    second = cv2.GaussianBlur(second, (0, 0), settings.blur)
    weight = np.maximum(second[..., 1:], 1e-3)
    colours, spread_c = first[..., :3] / weight, second[..., :1] / weight
    spread_l = first[..., 3:] / weight
    known = np.clip(2.0 * second[..., 1] - 1.0, 0.0, 1.0)
    return colours, np.concatenate([spread_l, spread_c], axis=-1), known
