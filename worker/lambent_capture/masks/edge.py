"""The outline at the resolution of the photograph, with soft edges."""

import cv2
import numpy as np
from jaxtyping import UInt8
from numpy import ndarray

from lambent_capture.arrays import Colours32, Grey, Grey32, Reduced32, Region, Rgb

_RADIUS = 3
"""Half the side of the window in which coverage is linear in colour, pixels of the cut."""
_EPSILON = 6.0e-4
"""Variance of colours (0..1 squared) below which an edge does not count."""


def soft_coverage(small_srgb: Rgb, mask: Region, image_srgb: UInt8[ndarray, "rows columns 3"]) -> Reduced32:
    """Return how much of each pixel of `image_srgb` the object covers, 0..1.

    `mask` is the object in the same picture at the size of `small_srgb`. Around its outline coverage is a
    linear function of colour in every window: found at the small size, applied at the large one.
    Source: He, Sun, Tang: Guided image filtering, ECCV 2010, Eq. 14 to 16; He, Sun: Fast guided filter, 2015.
    """
    slope, offset = _linear_model(small_srgb.astype(np.float32) / 255.0, mask.astype(np.float32))
    size = (image_srgb.shape[1], image_srgb.shape[0])
    colours = image_srgb.astype(np.float32) / np.float32(255.0)
    coverage = cv2.resize(offset, size, interpolation=cv2.INTER_LINEAR)
    for channel in range(3):
        factor = cv2.resize(slope[..., channel], size, interpolation=cv2.INTER_LINEAR)
        coverage += factor * colours[..., channel]
    kernel = np.ones((2 * _RADIUS + 1, 2 * _RADIUS + 1), np.uint8)
    inside = cv2.erode(mask.astype(np.uint8), kernel, borderValue=1).astype(np.float32)
    outside = cv2.dilate(mask.astype(np.uint8), kernel).astype(np.float32)
    low = cv2.resize(inside, size, interpolation=cv2.INTER_LINEAR)
    high = cv2.resize(outside, size, interpolation=cv2.INTER_LINEAR)
    return np.clip(np.clip(coverage, low, high), 0.0, 1.0)


def _linear_model(guide: Colours32, values: Grey) -> tuple[Colours32, Grey32]:
    """Return slope and offset of the values as a function of colour, averaged over all windows of a pixel."""

    def mean(each: ndarray) -> ndarray:
        return cv2.blur(each, (2 * _RADIUS + 1, 2 * _RADIUS + 1))

    middle, average = mean(guide), mean(values)
    covariance = np.empty((*values.shape, 3, 3), dtype=np.float32)
    for i in range(3):
        for j in range(i, 3):
            product = mean(guide[..., i] * guide[..., j]) - middle[..., i] * middle[..., j]
            covariance[..., i, j] = covariance[..., j, i] = product
    covariance += np.float32(_EPSILON) * np.eye(3, dtype=np.float32)
    shared = mean(guide * values[..., None]) - middle * average[..., None]
    slope = np.linalg.solve(covariance, shared[..., None])[..., 0].astype(np.float32)
    offset = average - (slope * middle).sum(axis=-1)
    return mean(slope), mean(offset)
