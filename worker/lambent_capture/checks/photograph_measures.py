"""Measures a single photograph that was read at reduced size."""

import numpy as np
from jaxtyping import UInt8
from lambent_core.colour import linear_from_srgb
from numpy import ndarray
from PIL import Image
from scipy import ndimage

from lambent_capture.arrays import Grey32, Reduced, Rgb

LUMA = np.array([0.299, 0.587, 0.114], dtype=np.float32)
SMALL_SIDE = 32
_TILE = 32
_FLAT_TILE = 16


def luma_of(image_srgb: Rgb) -> Grey32:
    """Return brightness as a picture encodes it, 0..255 (Rec. 601)."""
    return image_srgb.astype(np.float32) @ LUMA


def small_luma(luma: Grey32) -> UInt8[ndarray, "32 32"]:
    """Return the means of 32 x 32 parts of a photograph."""
    image = Image.fromarray(luma).resize((SMALL_SIDE, SMALL_SIDE), Image.Resampling.BOX)
    return np.round(np.asarray(image)).clip(0, 255).astype(np.uint8)


def difference_hash(luma: Grey32) -> int:
    """Return 64 bits: whether each of 8 x 8 parts is brighter than its right neighbour.

    Source: N. Krawetz, "Kind of like that" (dHash), 2013. Blind to exposure and to small changes.
    """
    parts = np.asarray(Image.fromarray(luma).resize((9, 8), Image.Resampling.BOX))
    return int("".join("1" if bit else "0" for bit in (parts[:, :-1] > parts[:, 1:]).ravel()), 2)


def sharpness_of(luma: Grey32) -> float:
    """Return fine over coarse contrast in the sharpest parts; only ratios mean anything, 0 where unknown.

    As `observe.fine_contrast`, for tiles of 32 pixels of which the 90th percentile counts: the background of
    a good photograph may be out of focus.
    """
    if min(luma.shape) < 2 * _TILE:
        return 0.0
    fine = luma - ndimage.gaussian_filter(luma, 0.7)
    coarse = ndimage.gaussian_filter(luma, 1.4) - ndimage.gaussian_filter(luma, 2.8)
    fine_power, coarse_power = _tile_means(fine * fine, _TILE), _tile_means(coarse * coarse, _TILE)
    textured = coarse_power > 1.0
    if textured.sum() < 4:
        return 0.0
    return float(np.percentile(np.sqrt(fine_power[textured] / coarse_power[textured]), 90.0))


def flat_share(image_srgb: Rgb) -> float:
    """Return the share of tiles of 16 x 16 pixels in which all pixels are equal; sensors have noise."""
    grey = image_srgb.max(axis=-1).astype(np.int16) * 256 + image_srgb.min(axis=-1)
    rows, columns = grey.shape[0] // _FLAT_TILE, grey.shape[1] // _FLAT_TILE
    if not rows or not columns:
        return 0.0
    tiles = grey[: rows * _FLAT_TILE, : columns * _FLAT_TILE].reshape(rows, _FLAT_TILE, columns, _FLAT_TILE)
    return float((tiles.max(axis=(1, 3)) == tiles.min(axis=(1, 3))).mean())


def brightness_ev(image_srgb: Rgb) -> float:
    """Return log2 of the median linear luminance, at least -10."""
    linear = linear_from_srgb(np.arange(256) / 255.0).astype(np.float32)
    luminance = linear[image_srgb] @ np.array([0.2126, 0.7152, 0.0722], dtype=np.float32)
    return float(np.log2(max(float(np.median(luminance)), 2.0**-10)))


def is_like_a_mask(image_srgb: Rgb) -> bool:
    """Return whether a picture is black and white but for an edge, with some of both."""
    grey = image_srgb.max(axis=-1) - image_srgb.min(axis=-1) <= 8
    black, white = image_srgb.max(axis=-1) <= 8, image_srgb.min(axis=-1) >= 247
    return bool(black.any() and white.any() and (grey & (black | white)).mean() > 0.97)


def _tile_means(values: Grey32, side: int) -> Reduced:
    rows, columns = values.shape[0] // side, values.shape[1] // side
    return values[: rows * side, : columns * side].reshape(rows, side, columns, side).mean(axis=(1, 3))
