"""Finds the object by agreement of all views: colours vote for cells of space, cells vote for pixels.

A cell of the object is seen as object by every view; an empty one is seen as background by some. So a vote
for background weighs more than one for object, and a few mistaken views are outvoted: a soft
visual hull. Its prediction for a view, without that view's own vote, is the prior for the next round of
colours.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, Int32
from numpy import ndarray
from PIL import Image
from scipy import ndimage

from lambent_capture.arrays import Bins, Cells, Grey, Marks, Rgb, Vector
from lambent_capture.masks import evidence
from lambent_capture.masks.lattice import SCENE, Frame, Lattice, main_parts
from lambent_capture.pictures.resample import reduced_size
from lambent_capture.scenes.picture_camera import PictureCamera

_AS_LIKELY = 0.25
"""How much smaller the sum of a cell may be than the best behind a marked pixel for it to be solid, too; log
odds for each view of the capture."""
_BORDER = 2
"""Pixels along the border that are background by definition."""
_LEAST_CELLS = 50
"""Fewer solid cells than this are not an object."""


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
    standing: float = 0.0
    """Votes of each view for a cell below the object, on a support: what is above it has to stand on
    something."""
    most_standing: float = 0.0
    """Sum of votes up to which these count."""


@dataclass(frozen=True, slots=True)
class MaskView:
    """A picture and the camera that took it, in its pixels."""

    name: str
    image_srgb: Rgb
    camera: PictureCamera

    def averaged(self, side: int) -> "MaskView":
        """Return the view with its longer side at most `side` pixels, each the mean over its area."""
        scale = min(1.0, side / max(self.camera.width, self.camera.height))
        size = (max(1, round(scale * self.camera.width)), max(1, round(scale * self.camera.height)))
        picture = cv2.resize(self.image_srgb, size, interpolation=cv2.INTER_AREA)
        return MaskView(self.name, picture, self.camera.resized(*size))

    def box_averaged(self, side: int) -> "MaskView":
        """Return the view reduced to `side` by Pillow, which rounds otherwise than `averaged`."""
        size = reduced_size(self.camera.width, self.camera.height, side)
        picture = Image.fromarray(self.image_srgb).resize(size, Image.Resampling.BOX)
        return MaskView(self.name, np.asarray(picture), self.camera.resized(*size))


@dataclass(frozen=True, kw_only=True, slots=True)
class Given:
    """Knowledge from before the views are compared: evidence of other kinds, and where an object can be."""

    frame: Frame
    low: Vector
    high: Vector
    """The box that is searched, in coordinates of `frame`: above the support, for instance."""
    focus: Vector | None = None
    """Where in this box the object is; what stands apart from it and further away is not the object."""
    odds: Sequence[Grey] = ()
    """Added to what colours say in each view, log odds at the size of its picture."""
    known: evidence.Known = evidence.NOTHING_KNOWN
    """For the learning of colours. What a person marked outvotes all views, too."""
    beliefs: Sequence[Grey] | None = None
    """Probability of the object at first, 0..1; None for a ball around what the cameras look at."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Prepared:
    """What is computed of each picture once, for any number of agreements."""

    lightness: list[Grey]
    """0..1."""
    colours: list[Bins]
    """Cells of the colour table."""
    distances: list[Bins] | None
    """Cells of the table of distances from the border; None where they are not used."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Consensus:
    """What the views agree on."""

    beliefs: list[Grey]
    """Probability that a pixel shows the object."""
    priors: list[Grey]
    """What the other views say about a pixel, through the cells behind it; log odds."""
    lattice: Lattice
    votes: Cells
    """Sum of the views' votes for each cell, log odds; the object is where it is positive."""
    unmarked: list[Grey]
    """What `priors` were without marks, everything else the same; empty where there are no marks."""


@dataclass(frozen=True, slots=True)
class _Grid:
    lattice: Lattice
    cameras: list[PictureCamera]
    pixels: list[Int32[ndarray, " cells"]]
    """Flat index of the pixel of each view that shows a cell, -1 outside."""


def agree(
    views: Sequence[MaskView],
    centre: Vector,
    distance: float,
    leaning: Leaning,
    settings: ConsensusSettings,
    given: Given | None = None,
    prepared: Prepared | None = None,
) -> Consensus | None:
    """Return for each view where the object is, or None where no object is left.

    `centre` is the point the cameras look at, `distance` how far they are from it, both in scene units.
    """
    half = np.full(3, settings.reach * distance)
    given = given or Given(frame=SCENE, low=centre - half, high=centre + half)
    marks = given.known.marks
    seen = prepared or prepare(views, edges=leaning.distance > 0.0)
    beliefs: Sequence[ndarray] = given.beliefs or [
        _without_border(_ball(view.camera, centre, settings.first_radius * distance)) for view in views
    ]
    grid = _grid(views, given.frame, given.low, given.high, settings.cells)
    kept = np.zeros((0, 3))
    for number in range(settings.rounds):
        if number - 1 in settings.refit_after:
            # The same number of cells in a smaller box: finer cells.
            grid = _closed_in(grid, kept, views, given, settings)
        # Each view by itself. Colours of object and background are learnt from the beliefs so far, so that
        # they become purer from round to round.
        odds = _odds(seen, beliefs, leaning, given)
        # A view votes on each cell by the pixel that shows it. A mark "background" is a veto: no cell that
        # is seen through this pixel is solid.
        free = [_votes(each, grid, view, settings) for view, each in enumerate(odds)]
        votes = [
            _without_marked(own, marks[view], grid.pixels[view], len(views)) if view in marks else own
            for view, own in enumerate(free)
        ]
        # A mark "object" says that some cell behind it is solid, and what is solid stands on something. Which
        # cells that makes solid follows from all votes together, so it changes the sum and no single vote.
        total = _with_what_stands_below(_with_marked(np.sum(votes, axis=0), marks, grid), grid, settings)
        if given.focus is not None:
            # Clutter next to the object has as many votes as the object; only its place tells it apart.
            solid = main_parts(total > 0.0, grid.lattice, given.focus, distance)
            total = np.where(solid, total, np.minimum(total, 0.0))
        if (total > 0.0).sum() < _LEAST_CELLS:
            return None
        # Cells vote for pixels: what the other views say is the prior of a view. Its own vote is taken off
        # the sum, or every view would confirm its own mistakes.
        kept = grid.lattice.local(total > 0.0)
        middle = given.frame.world(kept.mean(axis=0)[None])[0]
        priors = [_prior(grid, total - own, v, middle, leaning, settings) for v, own in enumerate(votes)]
        beliefs = [_without_border(_sigmoid(own + prior)) for own, prior in zip(odds, priors, strict=True)]
    unmarked = []
    if marks:
        # The last round once more without marks: the difference is what they have changed in other views.
        every = _with_what_stands_below(np.sum(free, axis=0), grid, settings)
        unmarked = [_prior(grid, every - own, v, middle, leaning, settings) for v, own in enumerate(free)]
    return Consensus(
        beliefs=list(beliefs), priors=priors, lattice=grid.lattice, votes=total, unmarked=unmarked
    )


def prepare(views: Sequence[MaskView], *, edges: bool) -> Prepared:
    """Return what `agree` needs of the pictures; `edges` only where a leaning weighs distances."""
    labs = [evidence.lab_of(view.image_srgb) for view in views]
    return Prepared(
        lightness=[lab[..., 0] / 100.0 for lab in labs],
        colours=[evidence.colour_cells(lab) for lab in labs],
        distances=[evidence.distance_cells(evidence.border_distance(lab)) for lab in labs] if edges else None,
    )


def _odds(seen: Prepared, beliefs: Sequence[ndarray], leaning: Leaning, given: Given) -> list[Grey]:
    """Return what each view says by itself, smoothed along its edges, log odds."""
    odds = [leaning.colour * each for each in evidence.colour_odds(seen.colours, beliefs, given.known)]
    if seen.distances is not None and leaning.distance > 0.0:
        far = evidence.distance_odds(seen.distances, beliefs)
        odds = [own + leaning.distance * each for own, each in zip(odds, far, strict=True)]
    if given.odds:
        odds = [own + extra for own, extra in zip(odds, given.odds, strict=True)]
    return [
        evidence.guided_smooth(guide, own, 2, 1e-3) for guide, own in zip(seen.lightness, odds, strict=True)
    ]


def _ball(camera: PictureCamera, centre: Vector, radius: float) -> Grey:
    """Return the initial estimate: a ball around the point the cameras look at."""
    column, row, _ = camera.project(centre[None])
    pixels = max(radius * camera.pixels_per_unit(centre), 1.0)
    rows, columns = np.mgrid[: camera.height, : camera.width] + 0.5
    return 0.7 * np.exp(-0.5 * ((columns - column[0]) ** 2 + (rows - row[0]) ** 2) / pixels**2)


def _without_border(belief: Grey) -> Grey:
    cut = belief.copy()
    cut[:_BORDER] = cut[-_BORDER:] = 0.0
    cut[:, :_BORDER] = cut[:, -_BORDER:] = 0.0
    return cut


def _sigmoid(odds: ndarray) -> ndarray:
    return 1.0 / (1.0 + np.exp(-np.clip(odds, -20.0, 20.0)))


def _grid(views: Sequence[MaskView], frame: Frame, low: Vector, high: Vector, cells: int) -> _Grid:
    lattice = Lattice.between(frame, low, high, cells)
    cameras = [view.camera for view in views]
    return _Grid(lattice, cameras, [lattice.pixels(camera) for camera in cameras])


def _closed_in(
    grid: _Grid,
    kept: Float[ndarray, "cells 3"],
    views: Sequence[MaskView],
    given: Given,
    settings: ConsensusSettings,
) -> _Grid:
    """Return a grid around the cells that were kept, with a margin of two cells, within the given box."""
    margin = 2.0 * grid.lattice.spacing
    low = np.maximum(kept.min(axis=0) - margin, given.low)
    high = np.minimum(kept.max(axis=0) + margin, given.high)
    return _grid(views, given.frame, low, high, settings.cells)


def _votes(odds: Grey, grid: _Grid, view: int, settings: ConsensusSettings) -> Float[ndarray, " points"]:
    """Return a view's vote for each cell, log odds of object against empty space.

    An object's cell looks like the object but for one mistake in fifteen, an empty one in half of the views.
    """
    chance = _sigmoid(np.clip(odds, -6.0, 6.0)).ravel()
    vote = np.clip(
        np.log((0.93 * chance + 0.07 * (1.0 - chance)) / 0.5), -settings.against, settings.in_favour
    )
    # The last entry is what the index -1 finds.
    return np.append(vote, settings.unseen).astype(np.float32)[grid.pixels[view]]


def _with_what_stands_below(total: Cells, grid: _Grid, settings: ConsensusSettings) -> Cells:
    """Return the votes with those for cells that have something of the object above them.

    The third axis of the lattice points away from the support.
    """
    if settings.standing <= 0.0:
        return total
    cells = total.reshape(grid.lattice.shape)
    solid = cells > 0.0
    covered = np.maximum.accumulate(solid[..., ::-1], axis=2)[..., ::-1] & ~solid
    raised = np.minimum(cells + settings.standing * len(grid.cameras), settings.most_standing)
    return np.where(covered, np.maximum(raised, cells), cells).ravel()


def _without_marked(votes: Cells, mark: Marks, pixels: Int32[ndarray, " cells"], num_views: int) -> Cells:
    """Return a view's votes with those of marked pixels: nothing is solid behind the background."""
    return np.where(np.append(mark.ravel(), 0)[pixels] < 0, -2.0 * num_views, votes)


def _with_marked(total: Cells, marks: Mapping[int, Marks], grid: _Grid) -> Cells:
    """Return the sum of votes with something solid behind each pixel that was marked as the object.

    Which cell that is follows from the votes, and from the other views that were marked there: it is the one
    with the largest sum, where each of them counts for a fifth of all views.
    """
    share = 0.2 * len(grid.cameras)
    behind = {
        view: np.append(mark.ravel(), 0)[grid.pixels[view]] > 0
        for view, mark in marks.items()
        if (mark > 0).any()
    }
    score = total + share * np.sum(list(behind.values()), axis=0)
    lattice = grid.lattice
    middle = lattice.frame.world((lattice.low + 0.5 * lattice.spacing * np.array(lattice.shape))[None])[0]
    result = total.copy()
    for view, inside in behind.items():
        best, _ = _best_behind(grid, np.where(inside, score, -1e9), view, middle)
        least = np.append(best.ravel(), np.inf)[grid.pixels[view]] - _AS_LIKELY * len(grid.cameras)
        result = np.where(inside & (score >= least), np.maximum(result, share), result)
    return result


def _best_behind(grid: _Grid, votes: Cells, view: int, middle: Vector) -> tuple[Grey, int]:
    """Return the largest sum of votes behind each pixel, within reach of a cell's size, and that reach.

    Log odds, and pixels.
    """
    camera = grid.cameras[view]
    best = np.full(camera.height * camera.width + 1, -1e3, dtype=np.float32)
    np.maximum.at(best, grid.pixels[view], votes)
    radius = max(1, int(np.ceil(0.5 * grid.lattice.spacing * camera.pixels_per_unit(middle))))
    picture = best[:-1].reshape(camera.height, camera.width)
    return ndimage.maximum_filter(picture, size=2 * radius + 1), radius


def _prior(
    grid: _Grid,
    votes: Float[ndarray, " points"],
    view: int,
    middle: Vector,
    leaning: Leaning,
    settings: ConsensusSettings,
) -> Grey:
    """Return the evidence of the cells behind each pixel, log odds.

    Against the object where no cell is solid within reach of a cell's size; for it only further inside, since
    cells are larger than pixels.
    """
    wide, radius = _best_behind(grid, votes, view, middle)
    deep = ndimage.minimum_filter(wide, size=2 * (radius + 1) + 1)
    against = np.clip(wide / settings.scale, -leaning.least_hull, 0.0)
    return against + np.clip(deep / settings.scale, 0.0, leaning.most_hull)
