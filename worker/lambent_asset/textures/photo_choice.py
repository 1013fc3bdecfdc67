"""Choice of the photograph that gives the detail of each part of the surface, and of its level.

Each node compares what all photographs say about its albedo. One that disagrees with their median (a
highlight, a passer-by, a wrong pose) or is less sharp than others counts less. Detail comes from one
photograph at a time, for the model's surface is not exact to a pixel and a mean over photographs would blur
it; the choice is smooth over the surface, and at its borders one photograph fades into the next.
"""

from dataclasses import dataclass

import numpy as np
import scipy.sparse
from jaxtyping import Float, Float32, Int
from numpy import ndarray

from lambent_asset.textures.photo_nodes import Nodes

LEVELLED_OVER = 20
"""Means over neighbours behind a photograph's level: broader changes of albedo are the model's."""
_LEVEL_RANGE = (0.2, 5.0)
"""Factors of a photograph's level are limited to these."""
_AGREEMENT = 0.25
"""Difference from the median (natural logarithm) at which a photograph counts 1/e."""
_SHARPEST = 1.5
"""Resolution beyond so many pixels per texel counts no more."""
_ROUNDS, _TOGETHER = 5, 0.6
"""Rounds in which nodes look at their neighbours' choice, and how much that weighs."""
_RIVAL = 0.35
"""A photograph may be chosen where its score is at least this share of the best one's."""
_FADE = 2
"""Means over neighbours along which one photograph fades into the next."""


@dataclass(frozen=True, slots=True, eq=False)
class Observations:
    """What one photograph says about the nodes that it shows."""

    node: Int[ndarray, " seen"]
    albedo: Float32[ndarray, "seen 3"]
    resolution: Float32[ndarray, " seen"]
    """Pixels per texel of the texture to be made."""
    trust: Float32[ndarray, " seen"]
    """0..1: how much of the radiance is albedo's, and how little of it a sharp reflection."""
    detail: Float32[ndarray, " seen"]
    """Share by which luminance changes from pixel to pixel."""


@dataclass(frozen=True, slots=True, eq=False)
class Choice:
    """The part of the surface for which one photograph gives the detail."""

    weight: Float32[ndarray, " nodes"]
    """0..1; over all photographs it sums to at most 1, and the model has the rest."""
    level: Float32[ndarray, "nodes 3"]
    """Factor from what the photograph says to albedo with the model's broad changes."""


def choose(nodes: Nodes, seen: list[Observations], model_albedo: Float32[ndarray, "nodes 3"]) -> list[Choice]:
    """Return the choice for each photograph of `seen`."""
    if not seen:
        return []
    count, views = len(nodes.texel), len(seen)
    scores = np.zeros((count, views), np.float32)
    for k, (observed, sharpness) in enumerate(zip(seen, _sharpness(count, seen), strict=True)):
        scores[observed.node, k] = sharpness * observed.trust * np.minimum(observed.resolution, _SHARPEST)
    agreement = _agreement(nodes, seen, scores)
    scores *= agreement
    chosen = _labels(nodes, scores)
    weights = _faded(nodes, scores > 0.0, chosen)
    choices = []
    for k, observed in enumerate(seen):
        trust = np.zeros((count, 1), np.float32)
        trust[observed.node, 0] = agreement[observed.node, k] * np.maximum(observed.trust, 1e-3)
        said = np.zeros((count, 3), np.float32)
        said[observed.node] = observed.albedo
        level = levels(nodes, said, model_albedo, trust)
        choices.append(Choice(weights[:, k], level))
    return choices


def levels(
    nodes: Nodes,
    said: Float32[ndarray, "nodes 3"],
    model: Float32[ndarray, "nodes 3"],
    trust: Float32[ndarray, "nodes 1"],
) -> Float32[ndarray, "nodes 3"]:
    """Return the factor that gives `said` the means of `model` over `LEVELLED_OVER` neighbourhoods."""
    means = nodes.blurred(np.concatenate([trust * model, trust * said], axis=1), LEVELLED_OVER)
    ratio = means[:, :3] / np.maximum(means[:, 3:], 1e-6)
    return np.clip(ratio, *_LEVEL_RANGE).astype(np.float32)


def _sharpness(count: int, seen: list[Observations]) -> list[float]:
    """Return the detail of each photograph relative to that of all at the same nodes, 0.04..1."""
    total, number = np.zeros(count), np.zeros(count)
    for observed in seen:
        total[observed.node] += observed.detail
        number[observed.node] += 1.0
    result = []
    for observed in seen:
        both = number[observed.node] > 1.0
        mean = (total[observed.node] / np.maximum(number[observed.node], 1.0))[both]
        # Detail decides where there is some: noise looks alike in all photographs.
        own = float((observed.detail[both] * mean).sum() / max(float((mean * mean).sum()), 1e-12))
        result.append(min(1.0, max(0.2, own)) ** 2 if both.any() else 1.0)
    return result


def _agreement(
    nodes: Nodes, seen: list[Observations], scores: Float32[ndarray, "nodes views"]
) -> Float32[ndarray, "nodes views"]:
    """Return how well each photograph agrees with the weighted median of all, 0..1."""
    said = np.full(scores.shape, np.nan, np.float32)
    for k, observed in enumerate(seen):
        said[observed.node, k] = np.log(np.maximum(observed.albedo.mean(axis=1), 1e-3))
    middle = weighted_median(said, scores)
    apart = np.abs(said - middle[:, None])
    there = np.isfinite(apart)
    apart = nodes.blurred(np.where(there, apart, 0.0), 1) / np.maximum(nodes.blurred(there, 1), 1e-6)
    agreement = np.exp(-((apart / _AGREEMENT) ** 2))
    medians = [
        float(np.median(apart[there[:, k], k])) if there[:, k].any() else 0.0 for k in range(len(seen))
    ]
    usual = max(float(np.median(medians)), 0.02)
    # A photograph that differs everywhere is badly posed, or of another light.
    worse = np.array([min(1.0, usual / max(value, 1e-6)) ** 2 for value in medians], np.float32)
    return np.where(there, agreement * worse, 0.0).astype(np.float32)


def weighted_median(
    values: Float[ndarray, "rows columns"], weights: Float[ndarray, "rows columns"]
) -> Float32[ndarray, " rows"]:
    """Return the weighted median of every row without its NaNs; 0 where nothing has a weight."""
    weights = np.where(np.isfinite(values), weights, 0.0)
    order = np.argsort(np.where(np.isfinite(values), values, np.inf), axis=1)
    reached = np.cumsum(np.take_along_axis(weights, order, axis=1), axis=1)
    place = (reached < 0.5 * reached[:, -1:]).sum(axis=1).clip(max=values.shape[1] - 1)
    median = np.take_along_axis(values, np.take_along_axis(order, place[:, None], axis=1), axis=1)[:, 0]
    return np.where(reached[:, -1] > 0.0, np.nan_to_num(median), 0.0).astype(np.float32)


def _labels(nodes: Nodes, scores: Float32[ndarray, "nodes views"]) -> Int[ndarray, " nodes"]:
    """Return the photograph chosen at every node, -1 where none shows it."""
    smooth = np.where(scores > 0.0, nodes.blurred(scores, 2), 0.0)
    best = smooth.max(axis=1, keepdims=True)
    share = smooth / np.maximum(best, 1e-12)
    label = share.argmax(axis=1)
    for _ in range(_ROUNDS):
        around = nodes.blurred(_one_hot(label, scores.shape[1]), 2)
        label = np.where(share >= _RIVAL, share + _TOGETHER * around, -1.0).argmax(axis=1)
    return np.where(best[:, 0] > 0.0, label, -1)


def _faded(nodes: Nodes, visible: ndarray, label: Int[ndarray, " nodes"]) -> Float32[ndarray, "nodes views"]:
    """Return the weight of every photograph, which fades at borders and never leaves what it shows."""
    some = label >= 0
    weights = nodes.blurred(_one_hot(label, visible.shape[1]), _FADE) * visible
    share = nodes.blurred(some[:, None].astype(np.float32), _FADE)
    total = weights.sum(axis=1, keepdims=True)
    return (weights / np.maximum(total, 1e-6) * share * (total > 1e-6)).astype(np.float32)


def _one_hot(label: Int[ndarray, " nodes"], count: int) -> Float32[ndarray, "nodes count"]:
    """Return [node, count] with a 1 at every label that is not negative."""
    rows = np.flatnonzero(label >= 0)
    ones = np.ones(len(rows), np.float32)
    return scipy.sparse.csr_array((ones, (rows, label[rows])), shape=(len(label), count)).toarray()
