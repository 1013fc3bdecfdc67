"""Finds the object by agreement of all views: colours vote for cells of space, cells vote for pixels.

A cell of the object is seen as object by every view; an empty one is seen as background by some. So a vote
for background weighs more than one for object, and a few mistaken views are outvoted: a soft
visual hull. Its prediction for a view, without that view's own vote, is the prior for the next round of
colours.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int, Int8, Int32, UInt8
from numpy import ndarray
from scipy import ndimage

from lambent_capture.checks.picture_camera import PictureCamera
from lambent_capture.masks import evidence
from lambent_capture.masks.lattice import SCENE, Frame, Lattice, main_parts

_AS_LIKELY = 0.25
"""How much smaller the sum of a cell may be than the best behind a marked pixel for it to be solid, too; log
odds for each view of the capture."""
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
    standing: float = 0.0
    """Votes of each view for a cell below the object, on a support: what is above it has to stand on
    something."""
    most_standing: float = 0.0
    """Sum of votes up to which these count."""


@dataclass(frozen=True, slots=True)
class MaskView:
    """A picture and the camera that took it, in its pixels."""

    name: str
    image_srgb: UInt8[ndarray, "height width 3"]
    camera: PictureCamera


@dataclass(frozen=True, slots=True)
class Given:
    """What is known before the views are compared: evidence of other kinds, and where an object can be."""

    odds: Sequence[Float[ndarray, "height width"]]
    """Added to what colours say in each view, log odds at the size of its picture."""
    known: evidence.Known
    """For the learning of colours. What a person marked outvotes all views, too."""
    beliefs: Sequence[Float[ndarray, "height width"]] | None
    """What is believed at first, 0..1; None for a ball around what the cameras look at."""
    frame: Frame
    low: Float[ndarray, "3"]
    high: Float[ndarray, "3"]
    """The box that is searched, in coordinates of `frame`: above the support, for instance."""
    focus: Float[ndarray, "3"]
    """Where in this box the object is; what stands apart from it and further away is not the object."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Prepared:
    """What is computed of each picture once, for any number of agreements."""

    lightness: list[Float[ndarray, "height width"]]
    """0..1."""
    colours: list[Int[ndarray, "height width"]]
    """Cells of the colour table."""
    distances: list[Int[ndarray, "height width"]] | None
    """Cells of the table of distances from the border; None where they are not used."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Agreement:
    """What the views agree on."""

    beliefs: list[Float[ndarray, "height width"]]
    """Probability that a pixel shows the object."""
    priors: list[Float[ndarray, "height width"]]
    """What the other views say about a pixel, through the cells behind it; log odds."""
    lattice: Lattice
    votes: Float[ndarray, " cells"]
    """Sum of the views' votes for each cell, log odds; the object is where it is positive."""
    unmarked: list[Float[ndarray, "height width"]]
    """What `priors` were without marks, everything else the same; empty where there are no marks."""


@dataclass(frozen=True, slots=True)
class _Grid:
    lattice: Lattice
    pixels: list[Int32[ndarray, " cells"]]
    """Flat index of the pixel of each view that shows a cell, -1 outside."""


def agree(
    views: Sequence[MaskView],
    centre: Float[ndarray, "3"],
    distance: float,
    leaning: Leaning,
    settings: ConsensusSettings,
    given: Given | None = None,
    prepared: Prepared | None = None,
) -> Agreement | None:
    """Return for each view where the object is, or None where no object is left.

    `centre` is the point the cameras look at, `distance` how far they are from it, both in scene units.
    """
    seen = prepare(views, edges=leaning.distance > 0.0) if prepared is None else prepared
    beliefs = [
        _without_border(_ball(view.camera, centre, settings.first_radius * distance)) for view in views
    ]
    half = np.full(3, settings.reach * distance)
    frame, low, high = SCENE, centre - half, centre + half
    if given is not None:
        frame, low, high = given.frame, given.low, given.high
        beliefs = beliefs if given.beliefs is None else [np.asarray(each) for each in given.beliefs]
    grid = _grid(views, frame, low, high, settings.cells)
    agreement = None
    for number in range(settings.rounds):
        odds = _odds(seen, beliefs, leaning, given)
        votes = [_votes(each, grid, view, settings) for view, each in enumerate(odds)]
        free = votes.copy()
        marks = given.known.marks if given is not None else {}
        for view, mark in marks.items():
            votes[view] = _without_marked(votes[view], mark, grid.pixels[view], len(views))
        total = np.sum(votes, axis=0)
        if any((mark > 0).any() for mark in marks.values()):
            total = _with_marked(total, marks, grid, views)
        if given is not None and settings.standing > 0.0:
            total = _with_what_stands_below(total, grid.lattice, len(views), settings)
        solid = total > 0.0
        if given is not None:
            solid = main_parts(solid, grid.lattice, given.focus, distance)
            total = np.where(solid, total, np.minimum(total, 0.0))
        if solid.sum() < 50:
            return None
        kept = grid.lattice.local(solid)
        middle = frame.world(kept.mean(axis=0)[None])[0]
        priors = [
            _prior(grid, total - votes[v], v, views[v].camera, middle, leaning, settings)
            for v in range(len(views))
        ]
        beliefs = [_without_border(_sigmoid(own + prior)) for own, prior in zip(odds, priors, strict=True)]
        unmarked = []
        if number == settings.rounds - 1 and given is not None and given.known.marks:
            every = np.sum(free, axis=0)
            if settings.standing > 0.0:
                every = _with_what_stands_below(every, grid.lattice, len(views), settings)
            unmarked = [
                _prior(grid, every - own, v, views[v].camera, middle, leaning, settings)
                for v, own in enumerate(free)
            ]
        agreement = Agreement(
            beliefs=beliefs, priors=priors, lattice=grid.lattice, votes=total, unmarked=unmarked
        )
        if number in settings.refit_after:
            margin = 2.0 * grid.lattice.spacing
            fresh_low = np.maximum(kept.min(axis=0) - margin, low)
            grid = _grid(views, frame, fresh_low, np.minimum(kept.max(axis=0) + margin, high), settings.cells)
    return agreement


def prepare(views: Sequence[MaskView], *, edges: bool) -> Prepared:
    """Return what `agree` needs of the pictures; `edges` only where a leaning weighs distances."""
    labs = [evidence.lab_of(view.image_srgb) for view in views]
    return Prepared(
        lightness=[lab[..., 0] / 100.0 for lab in labs],
        colours=[evidence.colour_cells(lab) for lab in labs],
        distances=[evidence.distance_cells(evidence.border_distance(lab)) for lab in labs] if edges else None,
    )


def _odds(
    seen: Prepared, beliefs: Sequence[ndarray], leaning: Leaning, given: Given | None
) -> list[Float[ndarray, "height width"]]:
    """Return what each view says by itself, smoothed along its edges, log odds."""
    known = evidence.NOTHING_KNOWN if given is None else given.known
    odds = [leaning.colour * each for each in evidence.colour_odds(seen.colours, beliefs, known)]
    if seen.distances is not None and leaning.distance > 0.0:
        far = evidence.distance_odds(seen.distances, beliefs)
        odds = [own + leaning.distance * each for own, each in zip(odds, far, strict=True)]
    if given is not None:
        odds = [own + extra for own, extra in zip(odds, given.odds, strict=True)]
    return [
        evidence.guided_smooth(guide, own, 2, 1e-3) for guide, own in zip(seen.lightness, odds, strict=True)
    ]


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
    views: Sequence[MaskView],
    frame: Frame,
    low: Float[ndarray, "3"],
    high: Float[ndarray, "3"],
    cells: int,
) -> _Grid:
    lattice = Lattice.between(frame, low, high, cells)
    return _Grid(lattice, [lattice.pixels(view.camera) for view in views])


def _votes(
    odds: Float[ndarray, "height width"], grid: _Grid, view: int, settings: ConsensusSettings
) -> Float[ndarray, " points"]:
    """Return a view's vote for each cell, log odds of object against empty space.

    An object's cell looks like the object but for one mistake in fifteen, an empty one in half of the views.
    """
    chance = _sigmoid(np.clip(odds, -6.0, 6.0)).ravel()
    vote = np.clip(
        np.log((0.93 * chance + 0.07 * (1.0 - chance)) / 0.5), -settings.against, settings.in_favour
    )
    # The last entry is what the index -1 finds.
    return np.append(vote, settings.unseen).astype(np.float32)[grid.pixels[view]]


def _with_what_stands_below(
    total: Float[ndarray, " cells"], lattice: Lattice, num_views: int, settings: ConsensusSettings
) -> Float[ndarray, " cells"]:
    """Return the votes with those for cells that have something of the object above them.

    The third axis of the lattice points away from the support.
    """
    cells = total.reshape(lattice.shape)
    solid = cells > 0.0
    covered = np.maximum.accumulate(solid[..., ::-1], axis=2)[..., ::-1] & ~solid
    raised = np.minimum(cells + settings.standing * num_views, settings.most_standing)
    return np.where(covered, np.maximum(raised, cells), cells).ravel()


def _without_marked(
    votes: Float[ndarray, " cells"],
    mark: Int8[ndarray, "height width"],
    pixels: Int32[ndarray, " cells"],
    num_views: int,
) -> Float[ndarray, " cells"]:
    """Return a view's votes with those of marked pixels: nothing is solid behind the background."""
    return np.where(np.append(mark.ravel(), 0)[pixels] < 0, -2.0 * num_views, votes)


def _with_marked(
    total: Float[ndarray, " cells"],
    marks: Mapping[int, Int8[ndarray, "height width"]],
    grid: _Grid,
    views: Sequence[MaskView],
) -> Float[ndarray, " cells"]:
    """Return the sum of votes with something solid behind each pixel that was marked as the object.

    Which cell that is follows from the votes, and from the other views that were marked there: it is the one
    with the largest sum, where each of them counts for a fifth of all views.
    """
    share = 0.2 * len(views)
    behind = {
        view: np.append(mark.ravel(), 0)[grid.pixels[view]] > 0
        for view, mark in marks.items()
        if (mark > 0).any()
    }
    score = total + share * np.sum(list(behind.values()), axis=0)
    middle = grid.lattice.frame.world(
        (grid.lattice.low + 0.5 * grid.lattice.spacing * np.array(grid.lattice.shape))[None]
    )[0]
    result = total.copy()
    for view, inside in behind.items():
        best, _ = _best_behind(grid, np.where(inside, score, -1e9), view, views[view].camera, middle)
        least = np.append(best.ravel(), np.inf)[grid.pixels[view]] - _AS_LIKELY * len(views)
        result = np.where(inside & (score >= least), np.maximum(result, share), result)
    return result


def _best_behind(
    grid: _Grid,
    votes: Float[ndarray, " cells"],
    view: int,
    camera: PictureCamera,
    middle: Float[ndarray, "3"],
) -> tuple[Float[ndarray, "height width"], int]:
    """Return the largest sum of votes behind each pixel, within reach of a cell's size, and that reach.

    Log odds, and pixels.
    """
    best = np.full(camera.height * camera.width + 1, -1e3, dtype=np.float32)
    np.maximum.at(best, grid.pixels[view], votes)
    radius = max(1, int(np.ceil(0.5 * grid.lattice.spacing * camera.pixels_per_unit(middle))))
    picture = best[:-1].reshape(camera.height, camera.width)
    return ndimage.maximum_filter(picture, size=2 * radius + 1), radius


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
    wide, radius = _best_behind(grid, votes, view, camera, middle)
    deep = ndimage.minimum_filter(wide, size=2 * (radius + 1) + 1)
    against = np.clip(wide / settings.scale, -leaning.least_hull, 0.0)
    return against + np.clip(deep / settings.scale, 0.0, leaning.most_hull)
