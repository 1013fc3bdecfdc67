"""Evidence for object or background at a pixel: its colour, and the edges between it and the border.

Probabilities become tables of colours and distances, smoothed histograms that are made anew in every round,
so nothing has to be known of the background but that the border of a picture shows it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray
from scipy import ndimage
from skimage.color import rgb2lab
from skimage.graph import MCP_Geometric

from lambent_capture.arrays import Bins, Cells, Grey, Marks, PerView, Rgb

_CELLS = (26, 40, 40)
"""Cells of a colour table along L, a and b of CIELAB; a cell is four units wide."""
TABLE_VOLUME = 64.0
"""Of a cell, CIELAB units cubed."""
_DISTANCES = 64
_DISTANCE_SCALE = 8.0
_STEP = 1e-3
"""Cost of a pixel without any edge."""
_NOISE = 1.0
"""Gradient, in CIELAB units per pixel, that is noise and costs nothing."""
_UNIFORM = 1.0 / 8000.0
"""Density of unexpected colours; about one over the number of cells that real colours fill."""
_MARKED = 0.02
"""Share of what a person marked in the colours of object and background: more would spread to parts of the
object that happen to have a marked colour."""
_LEAST_BACKGROUND = 0.01
"""Share of a picture that a kind of background needs for colours of its own."""
MAX_COLOUR = 4.0
"""Limit of what a colour alone may say, log odds."""


def lab_of(image_srgb: Rgb) -> Float[ndarray, "height width 3"]:
    """Return the CIELAB values of a picture; steps of one are just visible."""
    return rgb2lab(image_srgb)


def colour_cells(lab: Float[ndarray, "*shape 3"]) -> Int[ndarray, "*shape"]:
    """Return the cell of the colour table that each pixel falls into."""
    cells = np.floor(lab / 4.0 + [0.0, 20.0, 20.0]).astype(np.int64)
    low, high = np.zeros(3, dtype=np.int64), np.array(_CELLS) - 1
    return np.ravel_multi_index(tuple(np.moveaxis(np.clip(cells, low, high), -1, 0)), _CELLS)


def border_distance(lab: Float[ndarray, "height width 3"]) -> Grey:
    """Return the strength-weighted number of edges between each pixel and the picture's border.

    That is log(1 + cost) of the cheapest path that leaves the picture, a path's cost being the gradient along
    it. What a plain background surrounds is far away even where it has the background's colour.
    """
    smooth = ndimage.gaussian_filter(lab, (0.6, 0.6, 0.0))
    squares = [ndimage.sobel(smooth, axis=axis) ** 2 for axis in (0, 1)]
    gradient = np.sqrt(sum(square[..., :].sum(axis=-1) for square in squares)) / 8.0
    cost = _STEP + np.maximum(gradient - _NOISE, 0.0)
    height, width = cost.shape
    border = np.zeros(cost.shape, dtype=bool)
    border[[0, height - 1]] = border[:, [0, width - 1]] = True
    reached, _ = MCP_Geometric(cost).find_costs(np.argwhere(border))
    return np.log1p(reached)


def distance_cells(distance: Grey) -> Bins:
    """Return the cell of the distance table that each pixel falls into."""
    return np.clip((distance * _DISTANCE_SCALE).astype(np.int64), 0, _DISTANCES - 1)


def colour_table(cells: Int[ndarray, " pixels"], weights: Float[ndarray, " pixels"]) -> Cells:
    """Return the density of colours over the cells, neighbours mixed."""
    counts = np.bincount(cells, weights, int(np.prod(_CELLS))).reshape(_CELLS)
    smooth = ndimage.gaussian_filter(counts, 0.9)
    return (smooth / max(float(smooth.sum()), 1e-9)).ravel()


@dataclass(frozen=True, kw_only=True, slots=True)
class Known:
    """What is known of pixels before colours are learnt, for each view."""

    learnt: Sequence[Grey] | None = None
    """How much each pixel counts, 0..1; all of them where it is None."""
    beyond: Sequence[Grey] | None = None
    """1 where something else than the support is behind the object, 0 where it is the support. The two have
    colours of their own."""
    marks: Mapping[int, Marks] = field(default_factory=dict)
    """Pixels of some views that a person marked, 1 object and -1 background. Their colours make up a fixed
    share of those of object and backgrounds in all views."""


NOTHING_KNOWN = Known()


@dataclass(frozen=True, slots=True)
class ColourModel:
    """Densities of colours over the cells of the table."""

    objects: Cells
    """Of the object, in all views."""
    backgrounds: list[tuple[Cells, Cells]]
    """Of what is behind it in each view: of the support, and of what is beyond."""

    def odds(self, view: int, cells: Bins, beyond: Grey | None = None) -> Grey:
        """Return the log odds of object against background that the colours of a view give."""
        near, far = (
            np.clip(np.log(self.objects / table), -MAX_COLOUR, MAX_COLOUR)[cells]
            for table in self.backgrounds[view]
        )
        return np.asarray(near if beyond is None else np.where(beyond > 0.5, far, near))


def colour_odds(
    cells: Sequence[Bins], foreground: Sequence[Grey], known: Known = NOTHING_KNOWN
) -> list[Grey]:
    """Return the log odds of object against background that the colours of each view give.

    `foreground` is the belief so far. All views share the colours of the object; each has a background
    of its own, with a little of everybody's. Nothing says more than `MAX_COLOUR`.
    """
    model = learn_colours(cells, foreground, known)
    return [
        model.odds(number, own, None if known.beyond is None else known.beyond[number])
        for number, own in enumerate(cells)
    ]


def learn_colours(
    cells: Sequence[Bins], foreground: Sequence[Grey], known: Known = NOTHING_KNOWN
) -> ColourModel:
    """Return the colours of object and backgrounds; see `colour_odds`."""
    every_cell = np.concatenate([each.ravel() for each in cells])
    every_weight = np.concatenate([each.ravel() for each in foreground])
    counted = 1.0 if known.learnt is None else np.concatenate([each.ravel() for each in known.learnt])
    objects = 0.8 * colour_table(every_cell, counted * every_weight) + 0.2 * _UNIFORM
    objects = _with_marked(objects, cells, known.marks, 1)
    behind = [1.0 - each for each in foreground]
    if known.learnt is not None:
        behind = [weight * each for weight, each in zip(known.learnt, behind, strict=True)]
    if known.beyond is None:
        near = _background_tables(cells, behind, known)
        return ColourModel(objects, [(table, table) for table in near])
    parts = [
        _background_tables(
            cells,
            [w * (z if far else 1.0 - z) for w, z in zip(behind, known.beyond, strict=True)],
            known,
            behind,
        )
        for far in (False, True)
    ]
    return ColourModel(objects, list(zip(*parts, strict=True)))


def _background_tables(
    cells: Sequence[Bins], weights: Sequence[Grey], known: Known, everywhere: Sequence[Grey] | None = None
) -> list[Cells]:
    """Return each view's colours of the background, from `everywhere` where `weights` are hardly any."""
    shared = colour_table(
        np.concatenate([each.ravel() for each in cells]), np.concatenate([each.ravel() for each in weights])
    )
    tables = []
    for number, (own, weight) in enumerate(zip(cells, weights, strict=True)):
        enough = everywhere is None or weight.sum() >= _LEAST_BACKGROUND * weight.size
        used = weight if enough or everywhere is None else everywhere[number]
        table = colour_table(own.ravel(), used.ravel())
        mixed = 0.85 * table + 0.1 * (shared if enough else table) + 0.05 * _UNIFORM
        tables.append(_with_marked(mixed, cells, known.marks, -1))
    return tables


def _with_marked(table: Cells, cells: Sequence[Bins], marks: Mapping[int, Marks], label: int) -> Cells:
    pixels = [cells[number][mark == label] for number, mark in marks.items()]
    if not pixels or not sum(len(each) for each in pixels):
        return table
    marked = np.concatenate(pixels)
    return (1.0 - _MARKED) * table + _MARKED * colour_table(marked, np.ones(len(marked)))


def distance_odds(cells: Sequence[Bins], foreground: Sequence[Grey]) -> list[Grey]:
    """Return the log odds that the distances from the border give; one table for all views.

    Where backgrounds are full of edges the two distributions are alike, and the odds are near zero by
    themselves. Limits: -3 and 5, since only what is surrounded can be far away.
    """
    every_cell = np.concatenate([each.ravel() for each in cells])
    every_weight = np.concatenate([each.ravel() for each in foreground])
    tables = [
        ndimage.gaussian_filter1d(np.bincount(every_cell, weights, _DISTANCES) + 1.0, 1.5)
        for weights in (every_weight, 1.0 - every_weight)
    ]
    objects, backgrounds = (table / table.sum() for table in tables)
    odds = np.clip(np.log(objects / backgrounds), -3.0, 5.0)
    return [odds[each] for each in cells]


def separation(labs: Sequence[Float[ndarray, "height width 3"]], coverages: Sequence[Grey]) -> PerView:
    """Return how well the colours of other views' masks separate object and background in each view.

    That is the chance that a pixel inside of the view's mask has a colour that is more of the object's than
    one outside: 1 where they never look alike, 0.5 where the masks have nothing to do with the pictures. Even
    views are judged by the odd ones and vice versa, so no view is explained by itself. Distances
    are left out: the middle of a picture is far from its border whatever it shows.
    """
    cells = [colour_cells(lab).ravel() for lab in labs]
    weights = [coverage.ravel() for coverage in coverages]
    scores = np.zeros(len(labs))
    for judged, judges in ((slice(0, None, 2), slice(1, None, 2)), (slice(1, None, 2), slice(0, None, 2))):
        seen, inside = np.concatenate(cells[judges]), np.concatenate(weights[judges])
        objects = colour_table(seen, inside) + 0.02 * _UNIFORM
        odds = np.log(objects / (colour_table(seen, 1.0 - inside) + 0.02 * _UNIFORM))
        scores[judged] = [
            _chance_greater(odds[own][mask >= 0.5], odds[own][mask < 0.5])
            for own, mask in zip(cells[judged], weights[judged], strict=True)
        ]
    return scores


def _chance_greater(first: Float[ndarray, " first"], second: Float[ndarray, " second"]) -> float:
    """Return the chance that one of `first` is greater than one of `second`, ties counted half."""
    if not len(first) or not len(second):
        return 0.5
    # Half of the time that importing everything about masks takes, and corrections have no use for it.
    from scipy.stats import rankdata

    ranks = rankdata(np.concatenate([first, second]))[: len(first)]
    return float((ranks.mean() - 0.5 * (len(first) + 1)) / len(second))


def guided_smooth(guide: Grey, values: Grey, radius: int = 2, epsilon: float = 1e-3) -> Grey:
    """Return the values smoothed along, not across, the edges of `guide` (values 0..1).

    Source: He, Sun, Tang: Guided image filtering, ECCV 2010, Eq. 5 and 6.
    """

    def mean(each: ndarray) -> ndarray:
        return ndimage.uniform_filter(each, 2 * radius + 1, mode="nearest")

    mean_guide, mean_values = mean(guide), mean(values)
    variance = mean(guide * guide) - mean_guide**2
    slope = (mean(guide * values) - mean_guide * mean_values) / (variance + epsilon)
    return mean(slope) * guide + mean(mean_values - slope * mean_guide)
