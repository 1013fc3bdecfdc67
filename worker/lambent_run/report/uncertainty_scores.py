"""Scores the predicted uncertainty of albedo where the true albedo is known."""

from pathlib import Path

import numpy as np
from jaxtyping import Float
from lambent_core.scene import View
from lambent_relight.bundle.uncertainty import CHANNELS
from numpy import ndarray

from lambent_run.report.maps import load
from lambent_run.report.table import Table

FEWEST_PIXELS = 50
DARKEST = 1e-3
"""Albedo below this is compared as this: a relative error of nothing means nothing."""
INTERIOR_ALPHA = 0.99


def score_uncertainty(table: Table, out: Path, view: View, ratio: Float[ndarray, "3"]) -> None:
    """Note how predicted and actual relative errors of albedo go together on the object's inner pixels.

    `albedo_rank_correlation` is Spearman's, 1 if pixels with higher predicted uncertainty always have larger
    errors. `albedo_calibration` is the root mean square of actual over predicted error: 1 where the sizes are
    right, larger where the prediction is too sure.
    """
    uncertainty = load(out, "pred", view, "uncertainty")
    predicted = load(out, "pred", view, "albedo")
    if uncertainty is None or predicted is None or "albedo" not in view.truth:
        return
    truth = view.truth["albedo"].astype(np.float64)
    width = uncertainty[..., CHANNELS.index("albedo")]
    inside = (truth[..., 3] > INTERIOR_ALPHA) & (width > 0.0)
    if inside.sum() < FEWEST_PIXELS:
        return
    scaled = np.clip(predicted[..., :3] * ratio, DARKEST, 1.0)
    error = np.abs(np.log(scaled / np.clip(truth[..., :3], DARKEST, 1.0)))[inside]
    width = width[inside]
    if np.ptp(width) > 0.0 and np.ptp(error) > 0.0:
        correlation = rank_correlation(width, error.mean(axis=-1))
        table.add("uncertainty/albedo_rank_correlation", correlation)
    scores = error / width[:, None]
    table.add("uncertainty/albedo_calibration", float(np.sqrt(np.square(scores).mean())))


def rank_correlation(a: Float[ndarray, " values"], b: Float[ndarray, " values"]) -> float:
    """Return Spearman's correlation of two arrays, in neither of which all values are equal.

    Here because scipy.stats takes a second to import.
    """
    return float(np.corrcoef(_ranks(a), _ranks(b))[0, 1])


def _ranks(values: Float[ndarray, " values"]) -> Float[ndarray, " values"]:
    """Return the rank of each value; equal ones share the mean of theirs."""
    _, place, counts = np.unique(values, return_inverse=True, return_counts=True)
    return (np.cumsum(counts) - 0.5 * (counts - 1))[place]
