"""Carries a person's corrections on a few photographs to all of them.

What was marked is certain in its photograph. Elsewhere it is evidence: no cell of space behind a pixel of the
background is solid, one behind a pixel of the object is, and other pixels of the colours that were marked
are probably the same.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Int8
from lambent_core.errors import UsageError
from numpy import ndarray

from lambent_capture.arrays import Marks, Reduced32
from lambent_capture.masks.consensus import (
    Consensus,
    Given,
    Leaning,
    MaskView,
    agree,
    prepare,
)
from lambent_capture.masks.corrections import Correction, reduced_seeds, seeds_of
from lambent_capture.masks.cut import LIMIT
from lambent_capture.masks.evidence import Known
from lambent_capture.masks.workspace import Workspace
from lambent_capture.pictures.upright import turned_pixels, turned_size, upright_turns

_TURNED = 0.3
"""Log odds that the other views must have for something, or against it, to be sure of it."""
_MOVED = 0.5
"""Log odds by which the marks alone must have changed that, where it was undecided."""


@dataclass(frozen=True, kw_only=True, slots=True)
class PropagateSettings:
    """How much corrections count beyond the pixels they mark."""

    compare_side: int = 192
    """Longer side at which views are compared, pixels."""
    rounds: int = 2
    certain: float = 30.0
    """Log odds of a marked pixel."""


def propagated(
    work: Workspace, corrections: Sequence[Correction], settings: PropagateSettings | None = None
) -> Workspace:
    """Return the workspace with corrections applied to all views; `work` itself where there are none.

    `work` is what the estimate kept, never the result of earlier corrections: the list is complete. Raises
    `UsageError` (`config.corrections_invalid`) for a frame that the capture does not have.
    """
    settings = settings or PropagateSettings()
    require_frames(work, corrections)
    if not corrections:
        return work
    seeds = _seeds(work, corrections)
    small = [work.view(number).averaged(settings.compare_side) for number in range(len(work.names))]
    sizes = {number: (small[number].camera.width, small[number].camera.height) for number in seeds}
    marks = {number: reduced_seeds(each, sizes[number]) for number, each in seeds.items()}
    prepared = prepare(small, edges=False)
    given = _given(work, small, marks, settings)
    leaning = Leaning(colour=1.0, distance=0.0, most_hull=2.5, least_hull=4.0)
    # An object that was missed may be outside of the box that was found.
    missed = any((each > 0).any() for each in marks.values())
    rounds = replace(work.rounds, cells=64, rounds=settings.rounds, refit_after=(0,) if missed else ())
    if not missed:
        given = replace(given, low=work.found_low, high=work.found_high)
    agreement = agree(small, work.centre, work.distance, leaning, rounds, given, prepared)
    return _updated(work, small, seeds, given, agreement)


def require_frames(work: Workspace, corrections: Sequence[Correction]) -> None:
    """Raise `UsageError` (`config.corrections_invalid`) for a frame that the capture does not have."""
    unknown = sorted({each.frame for each in corrections} - set(work.names))
    if unknown:
        raise UsageError(
            "config.corrections_invalid",
            f'the corrections name "{unknown[0]}", which is not a frame of the capture; leave them out',
        )


def _updated(
    work: Workspace,
    small: Sequence[MaskView],
    seeds: dict[int, Marks],
    given: Given,
    agreement: Consensus | None,
) -> Workspace:
    shapes = [(view.camera.height, view.camera.width) for view in small]
    if agreement is None:  # Everything was marked as background.
        beliefs = tuple(np.zeros(shape, np.float32) for shape in shapes)
        priors = tuple(np.full(shape, -4.0, np.float32) for shape in shapes)
    else:
        beliefs = tuple(each.astype(np.float32) for each in agreement.beliefs)
        priors = tuple(
            _decided(
                _resized(before, (each.shape[1], each.shape[0])),
                unmarked.astype(np.float32),
                each.astype(np.float32),
            )
            for before, unmarked, each in zip(work.priors, agreement.unmarked, agreement.priors, strict=True)
        )
    return replace(
        work,
        beliefs=beliefs,
        priors=priors,
        learnt=tuple(each.astype(np.float32) for each in given.known.learnt or ()),
        beyond=tuple(each.astype(np.float32) for each in given.known.beyond or ()),
        seeds=seeds,
    )


def _decided(before: Reduced32, unmarked: Reduced32, after: Reduced32) -> Reduced32:
    """Return what the other views say now, final where a person's marks have turned or moved it.

    `found` is what they said when the object was found, `unmarked` what they would say now without the marks.
    The photograph itself still says the same as ever, and would overrule them: what stands apart from the
    table and looks like the object.
    """
    against, towards = after < -_TURNED, after > _TURNED
    gone = against & ((before > _TURNED) | (unmarked - after > _MOVED))
    came = towards & ((before < -_TURNED) | (after - unmarked > _MOVED))
    return np.where(gone, np.float32(-LIMIT), np.where(came, np.float32(LIMIT), after))


def _given(
    work: Workspace,
    small: Sequence[MaskView],
    marks: dict[int, Int8[ndarray, "rows columns"]],
    settings: PropagateSettings,
) -> Given:
    odds, learnt, beyond, beliefs = [], [], [], []
    for number, view in enumerate(small):
        size = (view.camera.width, view.camera.height)
        own = _resized(work.support_odds[number], size).astype(np.float64)
        counts = _resized(work.learnt[number], size).astype(np.float64)
        belief = _resized(work.beliefs[number], size).astype(np.float64)
        if number in marks:
            mark = marks[number]
            own = np.where(mark == 0, own, settings.certain * mark)
            counts = np.where(mark == 0, counts, 1.0)
            belief = np.where(mark == 0, belief, 0.5 + 0.5 * mark)
        odds.append(own)
        learnt.append(counts)
        beyond.append(_resized(work.beyond[number], size).astype(np.float64))
        beliefs.append(belief)
    return Given(
        odds=odds,
        known=Known(learnt=learnt, beyond=beyond, marks=marks),
        beliefs=beliefs,
        frame=work.frame,
        low=work.low,
        high=work.high,
        focus=(work.centre - work.frame.origin) @ work.frame.axes.T,
    )


def _seeds(work: Workspace, corrections: Sequence[Correction]) -> dict[int, Marks]:
    seeds = {}
    for number, name in enumerate(work.names):
        rows, columns = work.pictures[number].shape[:2]
        camera = work.cameras[number]
        turns = upright_turns(camera.camera_to_world)
        size = turned_size((columns, rows), turns)
        full = turned_size((camera.width, camera.height), turns)
        own = seeds_of(corrections, name, size, (size[0] / full[0], size[1] / full[1]))
        if own is not None:
            seeds[number] = turned_pixels(own, -turns)
    return seeds


def _resized(values: ndarray, size: tuple[int, int]) -> Reduced32:
    return np.asarray(cv2.resize(values.astype(np.float32), size, interpolation=cv2.INTER_AREA))
