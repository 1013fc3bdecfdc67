"""Importance sampling of an environment map.

A pixel is drawn in proportion to its radiance times its exact solid angle, and a direction inside it
uniformly in solid angle, so the density is constant over a pixel and known exactly. Source: the
TensoIR sampler the paper's code uses, with the exact angles and jitter.
"""

import math

import numpy as np
from numpy.typing import NDArray

from lambent_relight.directions import Array, pixel_solid_angles, rotate_about_z, uv_of_directions
from lambent_relight.environments import Environment


class LightSampler:
    """Draws directions towards the bright parts of an environment."""

    def __init__(self, environment: Environment) -> None:
        """Tabulate `environment`; linear in its number of pixels."""
        self._height, self._width = environment.radiance.shape[:2]
        self._rotate_deg = environment.rotate_deg
        weight = _pixel_means(environment.radiance.astype(np.float64).sum(axis=-1))
        weight *= pixel_solid_angles(self._height, self._width)[:, None]
        if weight.sum() <= 0.0:
            weight += pixel_solid_angles(self._height, self._width)[:, None]
        self.pmf: NDArray[np.float64] = weight / weight.sum()
        """Probability of every pixel, [height, width], sums to one."""
        self._row_ends = np.cumsum(self.pmf.sum(axis=1))
        self._pixel_ends = np.cumsum(self.pmf.ravel())
        self._solid_angles = pixel_solid_angles(self._height, self._width)
        self._densities = (self.pmf / self._solid_angles[:, None]).astype(np.float32)

    def sample(self, u1: Array, u2: Array) -> NDArray[np.float32]:
        """Return directions [*batch, 3] from uniforms `u1`, `u2` [*batch] in [0, 1).

        Nearby uniforms give nearby directions, so stratified uniforms stay stratified.
        """
        shape = np.shape(u1)
        total = self._row_ends[-1]
        target = np.ravel(u1) * total
        row = np.minimum(np.searchsorted(self._row_ends, target, side="right"), self._height - 1)
        row_start = np.where(row > 0, self._row_ends[row - 1], 0.0)
        row_mass = np.maximum(self._row_ends[row] - row_start, 1e-300)
        inside_row = np.clip((target - row_start) / row_mass, 0.0, 1.0)

        first = row * self._width
        begin = np.where(first > 0, self._pixel_ends[first - 1], 0.0)
        span = self._pixel_ends[first + self._width - 1] - begin
        target = begin + np.ravel(u2) * span
        pixel = np.searchsorted(self._pixel_ends, target, side="right")
        pixel = np.clip(pixel, first, first + self._width - 1)
        pixel_start = np.where(pixel > 0, self._pixel_ends[pixel - 1], 0.0)
        pixel_mass = np.maximum(self._pixel_ends[pixel] - pixel_start, 1e-300)
        inside_pixel = np.clip((target - pixel_start) / pixel_mass, 0.0, 1.0)

        top = np.cos(math.pi * row / self._height)
        bottom = np.cos(math.pi * (row + 1) / self._height)
        z = top + (bottom - top) * inside_row
        azimuth = math.pi - (2.0 * math.pi / self._width) * (pixel - first + inside_pixel)
        radius = np.sqrt(np.maximum(1.0 - z * z, 0.0))
        directions = np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), z], axis=-1)
        return rotate_about_z(directions, self._rotate_deg).astype(np.float32).reshape(*shape, 3)

    def pdf(self, directions: Array) -> NDArray[np.float32]:
        """Return the density of `sample` at unit `directions` [*batch, 3], 1/sr, as [*batch, 1]."""
        if self._rotate_deg:
            directions = rotate_about_z(directions, -self._rotate_deg)
        u, v = uv_of_directions(directions)
        column = np.floor(u * self._width).astype(np.int64) % self._width
        row = np.clip(np.floor(v * self._height).astype(np.int64), 0, self._height - 1)
        return self._densities.ravel()[row * self._width + column][..., None]


def _pixel_means(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the mean of the bilinear interpolant over every pixel.

    The centre alone would give a black pixel beside a bright one probability zero, although the
    interpolated radiance there is not zero.
    """
    wrapped = 0.75 * values + 0.125 * (np.roll(values, 1, axis=1) + np.roll(values, -1, axis=1))
    above = np.concatenate([wrapped[:1], wrapped[:-1]])
    below = np.concatenate([wrapped[1:], wrapped[-1:]])
    return 0.75 * wrapped + 0.125 * (above + below)
