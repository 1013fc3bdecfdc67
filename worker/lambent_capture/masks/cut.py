"""Cuts the object out of a picture: the cheapest outline between what evidence says, along edges.

Graph cut after Boykov and Jolly, Interactive graph cuts, ICCV 2001, by the solver of `cv2.grabCut`.
"""

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray

from lambent_capture.arrays import Grey, Grey8, Region, Rgb

LIMIT = 6.0
"""Log odds beyond which more evidence changes nothing."""
_PER_ODD = 2.0
"""Levels of the picture's first channel for one unit of log odds: few, since steps of it look like edges."""
_MIDDLE = 128.0
_REACH = LIMIT * _PER_ODD


def cut_out(image_srgb: Rgb, odds: Grey, weight: float = 12.0) -> Region:
    """Return the pixels of the object, given the log odds of each (positive is object).

    `weight` is the cost of one unit of log odds, where an outline through an even area costs 50 for each
    pair of neighbours that it separates. Log odds at or beyond `LIMIT` are obeyed.
    """
    mask = np.where(odds > 0.0, cv2.GC_PR_FGD, cv2.GC_PR_BGD).astype(np.uint8)
    mask[odds >= LIMIT] = cv2.GC_FGD
    mask[odds <= -LIMIT] = cv2.GC_BGD
    if (odds <= 0.0).all() or (odds > 0.0).all():
        return odds > 0.0
    # `cv2.grabCut` knows colour models only. Evidence goes into a channel of its own, and the models are two
    # equal normal distributions along it, so that their log ratio is proportional to the evidence.
    channels = np.dstack([_coded(odds), _contrast(image_srgb, odds)])
    variance = 2.0 * _REACH * _PER_ODD / weight
    behind, front = (_model(_MIDDLE + side * _REACH, variance) for side in (-1.0, 1.0))
    cv2.grabCut(channels, mask, None, behind, front, 1, cv2.GC_EVAL_FREEZE_MODEL)
    return np.asarray((mask == cv2.GC_FGD) | (mask == cv2.GC_PR_FGD))


def _coded(odds: Grey) -> Grey8:
    return np.round(_MIDDLE + _PER_ODD * np.clip(odds, -LIMIT, LIMIT)).astype(np.uint8)


def _contrast(image_srgb: Rgb, odds: Grey) -> UInt8[ndarray, "height width 2"]:
    """Return lightness and the chroma that tells object and background apart most, where edges are sought."""
    lab = cv2.cvtColor(image_srgb, cv2.COLOR_RGB2LAB).astype(np.float32)
    inside = odds > 0.0
    axis = lab[inside][:, 1:].mean(axis=0) - lab[~inside][:, 1:].mean(axis=0)
    length = float(np.linalg.norm(axis))
    axis = axis / length if length > 1.0 else np.array([0.0, 1.0], dtype=np.float32)
    chroma = 128.0 + 1.5 * (lab[..., 1:] - 128.0) @ axis
    return np.dstack([lab[..., 0], np.clip(chroma, 0.0, 255.0)]).astype(np.uint8)


def _model(mean: float, variance: float) -> Float[ndarray, "1 65"]:
    """Return the mixture of `cv2.grabCut` with one component: five weights, means, covariances."""
    model = np.zeros((1, 65))
    model[0, 0] = 1.0
    model[0, 5:8] = mean, 128.0, 128.0
    # Wide enough in the colours that these make no difference.
    model[0, 20:29] = np.diag([variance, 1e6, 1e6]).ravel()
    return model
