"""Environments filtered by GGX lobes: equirectangular levels of increasing roughness.

Level k of K has perceptual roughness r = k / (K - 1), GGX width alpha = r^2. Level 0 is the map itself. With
n = omega_o = d, level k > 0 in direction d is

    sum_j w(d . d_j) L(d_j) Omega_j / sum_j w(d . d_j) Omega_j,
    w(c) = max(c, 0) / (alpha^2 (1 + c) / 2 + (1 - c) / 2)^2,

over the pixels j of a source map of the level's own size: (1 + c) / 2 is cos^2 of the half vector's angle, so
w is D(h) times the cosine, without the constant. A level has W columns and W / 2 rows, W = 16 / alpha rounded
up to a power of two, between 64 and 512; a texel is small beside the lobe wherever alpha is above 1/64.
The source is the mean of the map over each pixel (`area_mean`), or the map's interpolant where the map is
smaller. Sums over a row are circular convolutions and go through Fourier transforms. Linear in the map; a
constant stays constant.
Source: Karis 2013 (n = v = r, weight by the cosine); docs/reference/conventions.md (prefiltered levels).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from lambent_core.directions import Array, pixel_directions, pixel_solid_angles
from lambent_core.errors import SettingError
from numpy.typing import NDArray

from lambent_relight.environment.area_mean import area_mean
from lambent_relight.environment.level_lookup import interpolate_levels
from lambent_relight.environment.maps import Environment

NUM_LEVELS = 9
"""Levels of a bundle's reader: roughness 0, 1/8, ... 1."""
MAX_LEVELS = 16
_NARROWEST, _WIDEST = 64, 512
_ROWS_AT_ONCE = 8


@dataclass(frozen=True)
class Prefiltered:
    """The levels of an environment."""

    levels: tuple[NDArray[np.float32], ...]
    """Radiance [height, width, 3]; the first is the map, the last has roughness 1."""
    rotate_deg: float
    """The light is turned by this angle about +z, as in `Environment`."""

    def rotated(self, degrees: float) -> "Prefiltered":
        """Return the same light turned by a further +`degrees` about +z; nothing is filtered again."""
        return Prefiltered(self.levels, self.rotate_deg + degrees)

    def lookup(self, directions: Array, perceptual_roughness: Array) -> NDArray[np.float32]:
        """Return radiance [n, 3] for unit `directions` [n, 3] and `perceptual_roughness` [n] or [n, 1].

        Bilinear in a level (columns wrap, rows are held at the poles), linear in roughness between levels;
        roughness is clipped to [0, 1].
        """
        points = np.ascontiguousarray(directions, np.float32)
        rough = np.broadcast_to(np.asarray(perceptual_roughness, np.float32).ravel(), (len(points),))
        return interpolate_levels(self.levels, points, np.ascontiguousarray(rough), self.rotate_deg)


def level_width(alpha: float) -> int:
    """Return the number of columns of the level of GGX width `alpha` > 0."""
    return min(max(2 ** math.ceil(math.log2(16.0 / alpha)), _NARROWEST), _WIDEST)


def prefilter(environment: Environment, levels: int = NUM_LEVELS) -> Prefiltered:
    """Return `environment` in `levels` levels (2 to 16). Raises SettingError for another number of them."""
    if not 2 <= levels <= MAX_LEVELS:
        raise SettingError("relight.prefilter_levels", f"{levels} levels", f"use 2 to {MAX_LEVELS}")
    images = [environment.radiance]
    sources: dict[int, NDArray[np.float64]] = {}
    for index in range(1, levels):
        alpha = (index / (levels - 1)) ** 2
        width = level_width(alpha)
        if width not in sources:
            sources[width] = source_map(environment, width // 2, width)

        def lobe(cosine: Array, alpha: float = alpha) -> Array:
            width = alpha * alpha
            return np.maximum(cosine, 0.0) / (0.5 * (1.0 + cosine) * width + 0.5 * (1.0 - cosine)) ** 2

        images.append(zonal_mean(sources[width], lobe).astype(np.float32))
    return Prefiltered(tuple(images), environment.rotate_deg)


def source_map(environment: Environment, height: int, width: int) -> NDArray[np.float64]:
    """Return the unturned map at `height` x `width`: means over pixels, or interpolated."""
    image = environment.radiance
    if image.shape[0] >= height and image.shape[1] >= width:
        return area_mean(image, height, width)
    directions = pixel_directions(height, width)
    return Environment(image).lookup(directions).astype(np.float64)


def zonal_mean(source: Array, kernel: Callable[[Array], Array]) -> NDArray[np.float64]:
    """Return the mean of `source` [height, width, 3] under `kernel`(cosine) about every pixel, same shape.

    `width` must be even. Rows are convolved with each other in azimuth; the kernels of rows i and
    height - 1 - i are mirror images.
    """
    height, width, _ = source.shape
    polar = math.pi * (np.arange(height) + 0.5) / height
    azimuth = np.cos(2.0 * math.pi * np.arange(width // 2 + 1) / width)
    solid_angles = pixel_solid_angles(height, width)
    spectrum = np.fft.rfft(np.asarray(source, np.float64) * solid_angles[:, None, None], axis=1)
    # [frequency, row, channel]; the second half of the channels is upside down, for the mirrored rows.
    both = np.concatenate([spectrum, spectrum[::-1]], axis=2).transpose(1, 0, 2)
    both = np.concatenate([both.real, both.imag], axis=2)
    result = np.empty((height, width, source.shape[2]))
    num_channels = source.shape[2]
    for start in range(0, (height + 1) // 2, _ROWS_AT_ONCE):
        rows = np.arange(start, min(start + _ROWS_AT_ONCE, (height + 1) // 2))
        sine = np.sin(polar[rows])[:, None, None] * np.sin(polar)[:, None]
        cosine = np.cos(polar[rows])[:, None, None] * np.cos(polar)[:, None] + sine * azimuth
        # The transform of an even sequence is real: a cosine series of its first half.
        series = np.fft.irfft(kernel(cosine), n=width, axis=-1)[..., : width // 2 + 1] * width
        norm = series[:, :, 0] @ solid_angles
        product = series.transpose(2, 0, 1) @ both
        half = product.shape[-1] // 2
        turned = np.fft.irfft(product[..., :half] + 1j * product[..., half:], n=width, axis=0)
        mean = turned.transpose(1, 0, 2) / norm[:, None, None]
        result[rows] = mean[..., :num_channels]
        result[height - 1 - rows] = mean[..., num_channels:]
    return np.maximum(result, 0.0)


def irradiance(environment: Environment, height: int = 32) -> NDArray[np.float32]:
    """Return the irradiance over pi of a surface facing every direction, [height, 2 height, 3], unturned.

    The same convolution with the clamped cosine: exact but for the size of a pixel, unlike a few bands of
    spherical harmonics.
    """
    source = source_map(environment, height, 2 * height)
    return zonal_mean(source, lambda cosine: np.maximum(cosine, 0.0)).astype(np.float32)
