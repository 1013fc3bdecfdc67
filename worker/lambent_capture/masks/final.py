"""Draws the mask of one photograph at its own resolution, from the evidence of all."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy import ndimage

from lambent_capture.arrays import Grey8, Grey32, Reduced, Region, Rgb
from lambent_capture.masks import evidence
from lambent_capture.masks.corrections import reduced_seeds
from lambent_capture.masks.cut import LIMIT, cut_out
from lambent_capture.masks.edge import soft_coverage
from lambent_capture.masks.photograph import Photograph
from lambent_capture.masks.workspace import Workspace


@dataclass(frozen=True, kw_only=True, slots=True)
class FinalSettings:
    """How evidence is weighed when the outline is drawn."""

    cut_side: int = 1000
    """Longest side of the part of a photograph in which the outline is cut, pixels."""
    margin: float = 0.08
    """Around what is believed to be the object, as a share of its longer side."""
    hull: float = 1.0
    support: float = 0.75
    colour: float = 1.0
    """Factors on the three kinds of log odds."""
    impossible: float = 3.5
    """What the other views rule out by so much is not the object, log odds."""
    least_part: float = 0.01
    """Parts smaller than this share of the largest are dropped."""
    hole: float = 0.001
    """Holes smaller than this share of the object are filled."""


def colours_of(work: Workspace) -> evidence.ColourModel:
    """Return the colours of object and backgrounds, learnt from what the views agree on."""
    cells = []
    for number, belief in enumerate(work.beliefs):
        picture = work.pictures[number]
        small = cv2.resize(picture, belief.shape[::-1], interpolation=cv2.INTER_AREA)
        cells.append(evidence.colour_cells(evidence.lab_of(small)))
    marks = {
        number: reduced_seeds(each, work.beliefs[number].shape[::-1]) for number, each in work.seeds.items()
    }
    known = evidence.Known(learnt=work.learnt, beyond=work.beyond, marks=marks)
    return evidence.learn_colours(cells, work.beliefs, known)


def final_mask(
    photograph: Photograph,
    number: int,
    work: Workspace,
    colours: evidence.ColourModel,
    settings: FinalSettings,
) -> Grey8:
    """Return the mask of a photograph in its own pixels, 0 background to 255 object."""
    camera = photograph.camera
    full = np.zeros((camera.height, camera.width), dtype=np.uint8)
    box = _box(work.beliefs[number], settings.margin)
    if box is None:
        return full
    whole = np.array([camera.width, camera.height])
    low, high = np.floor(box[0] * whole).astype(int), np.ceil(box[1] * whole).astype(int)
    scale = min(1.0, settings.cut_side / int((high - low).max()))
    reduced = photograph.reduced(max(int(np.ceil(scale * max(camera.width, camera.height))), 1))
    size = np.array([reduced.camera.width, reduced.camera.height])
    first = np.floor(low * size / whole).astype(int)
    last = np.minimum(np.ceil(high * size / whole).astype(int), size)
    crop = reduced.image_srgb[first[1] : last[1], first[0] : last[0]]
    odds = _odds(work, number, colours, crop, (first / size, last / size), settings)
    mask = _tidy(cut_out(crop, odds), settings)
    if (size == whole).all():
        low, high, fine = first, last, crop
    else:
        low, high = np.round(first * whole / size).astype(int), np.round(last * whole / size).astype(int)
        fine = photograph.read(max(camera.width, camera.height))[low[1] : high[1], low[0] : high[0]]
    coverage = soft_coverage(crop, mask, np.ascontiguousarray(fine))
    full[low[1] : high[1], low[0] : high[0]] = np.round(255.0 * coverage).astype(np.uint8)
    return full


def preview_mask(
    number: int, work: Workspace, colours: evidence.ColourModel, settings: FinalSettings
) -> Region:
    """Return the mask of a view at the size of the evidence, without soft edges."""
    picture = work.pictures[number]
    mask = np.zeros(picture.shape[:2], dtype=bool)
    box = _box(work.beliefs[number], settings.margin)
    if box is None:
        return mask
    size = np.array([picture.shape[1], picture.shape[0]])
    low, high = np.floor(box[0] * size).astype(int), np.ceil(box[1] * size).astype(int)
    crop = np.ascontiguousarray(picture[low[1] : high[1], low[0] : high[0]])
    odds = _odds(work, number, colours, crop, (low / size, high / size), settings)
    mask[low[1] : high[1], low[0] : high[0]] = _tidy(cut_out(crop, odds), settings)
    return mask


def preview_masks(
    work: Workspace, settings: FinalSettings | None = None, go_on: Callable[[], None] = lambda: None
) -> list[Region]:
    """Return `preview_mask` of all views, computed in two threads; what `go_on` raises stops the work."""
    colours, chosen = colours_of(work), settings or FinalSettings()

    def draw(number: int) -> Region:
        go_on()
        return preview_mask(number, work, colours, chosen)

    with ThreadPoolExecutor(max_workers=2) as pool:
        return list(pool.map(draw, range(len(work.names))))


def _box(belief: Reduced, margin: float) -> tuple[Float[ndarray, "2"], Float[ndarray, "2"]] | None:
    """Return the corners of the box around the object as shares of the picture, with a margin."""
    shown = belief > 0.3
    if not shown.any():
        return None
    columns, rows = np.flatnonzero(shown.any(axis=0)), np.flatnonzero(shown.any(axis=1))
    size = np.array([belief.shape[1], belief.shape[0]])
    low, high = np.array([columns[0], rows[0]]), np.array([columns[-1], rows[-1]]) + 1
    around = margin * (high - low).max() + 3.0
    return np.maximum(low - around, 0.0) / size, np.minimum(high + around, size) / size


def _odds(
    work: Workspace,
    number: int,
    colours: evidence.ColourModel,
    crop: Rgb,
    part: tuple[Float[ndarray, "2"], Float[ndarray, "2"]],
    settings: FinalSettings,
) -> Grey32:
    size = (crop.shape[1], crop.shape[0])
    hull = _part(work.priors[number], part, size)
    odds = settings.hull * hull
    odds += settings.support * _part(work.support_odds[number], part, size)
    lab = cv2.cvtColor(crop.astype(np.float32) / np.float32(255.0), cv2.COLOR_RGB2LAB)
    beyond = _part(work.beyond[number], part, size)
    # Without a support, what the views believe contains their colours already.
    if work.has_support or work.seeds:
        odds += settings.colour * colours.odds(number, evidence.colour_cells(lab), beyond)
    odds = np.clip(odds, 0.01 - LIMIT, LIMIT - 0.01)
    odds[hull <= -settings.impossible] = -LIMIT
    if number in work.seeds:
        seeds = _part(work.seeds[number], part, size)
        odds = np.where(np.abs(seeds) >= 0.5, LIMIT * np.sign(seeds), odds)
    return np.asarray(odds, dtype=np.float32)


def _part(
    values: Reduced, part: tuple[Float[ndarray, "2"], Float[ndarray, "2"]], size: tuple[int, int]
) -> Grey32:
    """Return a part of a picture, corners as shares of it, enlarged to `size`."""
    rows, columns = values.shape
    low, high = part
    across = low[0] * columns + (np.arange(size[0]) + 0.5) * (high[0] - low[0]) * columns / size[0] - 0.5
    down = low[1] * rows + (np.arange(size[1]) + 0.5) * (high[1] - low[1]) * rows / size[1] - 0.5
    x, y = np.meshgrid(across.astype(np.float32), down.astype(np.float32))
    return np.asarray(
        cv2.remap(values.astype(np.float32), x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    )


def _tidy(mask: Region, settings: FinalSettings) -> Region:
    """Return the mask without small parts and small holes."""
    labels, number = ndimage.label(mask)
    if not number:
        return mask
    sizes = np.bincount(labels.ravel())
    sizes[0] = 0
    kept = (sizes >= settings.least_part * sizes.max())[labels] & mask
    labels, _ = ndimage.label(~kept)
    sizes = np.bincount(labels.ravel())
    small = sizes < settings.hole * kept.sum()
    small[0] = False
    return np.asarray(kept | small[labels])
