"""Finds the object by agreement of all views: colours vote for cells of space, cells vote for pixels.

A cell of the object is seen as object by every view; an empty one is seen as background by some. So a vote
for background weighs more than one for object, and a few mistaken views are outvoted: a soft
visual hull. Its prediction for a view, without that view's own vote, is the prior for the next round of
colours.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray
from scipy import ndimage

from lambent_worker.capture_qa.picture_camera import PictureCamera
from lambent_worker.masks import evidence

_BORDER = 2
"""Pixels along the border that are background by definition."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Leaning:
    """Weights of the sources of evidence."""

    colour: float
    """Factor on the log odds of colours."""
    distance: float
    """Factor on the log odds of distances from the border."""
    most_hull: float
    """Largest evidence of the hull for the object, log odds."""
    least_hull: float
    """Largest evidence of the hull against the object, log odds."""


@dataclass(frozen=True, kw_only=True, slots=True)
class ConsensusSettings:
    """Settings of the agreement between views."""

    rounds: int = 5
    cells: int = 48
    """Along the longest side of the box."""
    reach: float = 0.5
    """Half the side of the first box, as a share of the cameras' distance."""
    first_radius: float = 0.22
    """Radius of the ball that the object is first thought to be, as a share of the cameras' distance."""
    refit_after: tuple[int, ...] = (1, 3)
    """Rounds after which the box closes in on the object."""
    against: float = 2.0
    """Largest vote of one view against a cell, log odds; and for it: `in_favour`."""
    in_favour: float = 0.6
    unseen: float = -0.3
    """Vote of a view for a cell outside its picture."""
    scale: float = 6.0
    """Votes for a cell that are worth one unit of log odds in a pixel."""


@dataclass(frozen=True, slots=True)
class MaskView:
    """A picture and the camera that took it, in its pixels."""

    name: str
    image_srgb: UInt8[ndarray, "height width 3"]
    camera: PictureCamera


@dataclass(frozen=True, slots=True)
class _Grid:
    points: Float[ndarray, "points 3"]
    spacing: float
    shown: list[ndarray]
    pixels: list[ndarray]


def agree(
    views: Sequence[MaskView],
    centre: Float[ndarray, "3"],
    distance: float,
    leaning: Leaning,
    settings: ConsensusSettings,
) -> list[Float[ndarray, "height width"]] | None:
    """Return for each view the probability that a pixel shows the object, or None where no object is left.

    `centre` is the point the cameras look at, `distance` how far they are from it, both in scene units.
    """
    labs = [evidence.lab_of(view.image_srgb) for view in views]
    colours = [evidence.colour_cells(lab) for lab in labs]
    distances = [evidence.distance_cells(evidence.border_distance(lab)) for lab in labs]
    beliefs = [
        _without_border(_ball(view.camera, centre, settings.first_radius * distance)) for view in views
    ]
    half = np.full(3, settings.reach * distance)
    low, high = centre - half, centre + half
    grid = _grid(views, low, high, settings.cells)
    for number in range(settings.rounds):
        odds = [
            evidence.guided_smooth(
                lab[..., 0] / 100.0, leaning.colour * own + leaning.distance * far, 2, 1e-3
            )
            for lab, own, far in zip(
                labs,
                evidence.colour_odds(colours, beliefs),
                evidence.distance_odds(distances, beliefs),
                strict=True,
            )
        ]
        votes = [_votes(each, grid, view, settings) for view, each in enumerate(odds)]
        total = np.sum(votes, axis=0)
        solid = total > 0.0
        if solid.sum() < 50:
            return None
        middle = grid.points[solid].mean(axis=0)
        beliefs = [
            _without_border(
                _sigmoid(own + _prior(grid, total - votes[v], v, views[v].camera, middle, leaning, settings))
            )
            for v, own in enumerate(odds)
        ]
        if number in settings.refit_after:
            kept, margin = grid.points[solid], 2.0 * grid.spacing
            fresh_low = np.maximum(kept.min(axis=0) - margin, low)
            grid = _grid(views, fresh_low, np.minimum(kept.max(axis=0) + margin, high), settings.cells)
    return beliefs


def _ball(
    camera: PictureCamera, centre: Float[ndarray, "3"], radius: float
) -> Float[ndarray, "height width"]:
    """Return the initial estimate: a ball around the point the cameras look at."""
    column, row, _ = camera.project(centre[None])
    pixels = max(radius * camera.pixels_per_unit(centre), 1.0)
    rows, columns = np.mgrid[: camera.height, : camera.width] + 0.5
    return 0.7 * np.exp(-0.5 * ((columns - column[0]) ** 2 + (rows - row[0]) ** 2) / pixels**2)


def _without_border(belief: Float[ndarray, "height width"]) -> Float[ndarray, "height width"]:
    cut = belief.copy()
    cut[:_BORDER] = cut[-_BORDER:] = 0.0
    cut[:, :_BORDER] = cut[:, -_BORDER:] = 0.0
    return cut


def _sigmoid(odds: ndarray) -> ndarray:
    return 1.0 / (1.0 + np.exp(-np.clip(odds, -20.0, 20.0)))


def _grid(
    views: Sequence[MaskView], low: Float[ndarray, "3"], high: Float[ndarray, "3"], cells: int
) -> _Grid:
    spacing = float((high - low).max()) / cells
    counts = np.maximum(np.ceil((high - low) / spacing - 1e-6).astype(int), 1)
    axes = [start + (np.arange(count) + 0.5) * spacing for start, count in zip(low, counts, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    seen = [view.camera.pixels(points) for view in views]
    return _Grid(points, spacing, [each[0] for each in seen], [each[1] for each in seen])


def _votes(
    odds: Float[ndarray, "height width"], grid: _Grid, view: int, settings: ConsensusSettings
) -> Float[ndarray, " points"]:
    """Return a view's vote for each cell, log odds of object against empty space.

    An object's cell looks like the object but for one mistake in fifteen, an empty one in half of the views.
    """
    chance = _sigmoid(np.clip(odds, -6.0, 6.0)).ravel()[grid.pixels[view]]
    vote = np.clip(
        np.log((0.93 * chance + 0.07 * (1.0 - chance)) / 0.5), -settings.against, settings.in_favour
    )
    return np.where(grid.shown[view], vote, settings.unseen)


def _prior(
    grid: _Grid,
    votes: Float[ndarray, " points"],
    view: int,
    camera: PictureCamera,
    middle: Float[ndarray, "3"],
    leaning: Leaning,
    settings: ConsensusSettings,
) -> Float[ndarray, "height width"]:
    """Return the evidence of the cells behind each pixel, log odds.

    Against the object where no cell is solid within reach of a cell's size; for it only further inside, since
    cells are larger than pixels.
    """
    shown = grid.shown[view]
    best = np.full(camera.height * camera.width, -1e3)
    np.maximum.at(best, grid.pixels[view][shown], votes[shown])
    radius = max(1, int(np.ceil(0.5 * grid.spacing * camera.pixels_per_unit(middle))))
    wide = ndimage.maximum_filter(best.reshape(camera.height, camera.width), size=2 * radius + 1)
    deep = ndimage.minimum_filter(wide, size=2 * (radius + 1) + 1)
    against = np.clip(wide / settings.scale, -leaning.least_hull, 0.0)
    return against + np.clip(deep / settings.scale, 0.0, leaning.most_hull)
