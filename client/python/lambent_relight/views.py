"""Views of the object, with several rays for every pixel on or next to it.

One ray through each pixel's centre finds the relevant pixels; these are traced again with a grid of
rays. Pixel values are means over a pixel's rays, weighted by opacity where they describe the surface.
"""

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from lambent_relight.bundle.graphs import PrimaryHits, Rows, SurfaceCaches
from lambent_relight.cameras import Camera

MIN_OPACITY = 1e-3
"""Rays with less opacity than this count as misses."""


@dataclass(frozen=True)
class View:
    """The rays of a camera that hit the object, in the order of their pixels."""

    camera: Camera
    rays_per_pixel: int
    pixel: NDArray[np.intp]
    """Pixel of every ray, row * width + column, [ray]."""
    ray: NDArray[np.intp]
    """Number of every ray in the camera with a pixel for each of a pixel's rays, [ray]."""
    origin: Rows
    direction: Rows
    hits: PrimaryHits

    @property
    def num_rays(self) -> int:
        """The number of rays that hit the object."""
        return len(self.pixel)

    def coverage(self) -> Rows:
        """Return the share of every pixel that the object covers, [height, width, 1]."""
        share = self._sum(self.hits.opacity) / self.rays_per_pixel
        return np.clip(share, 0.0, 1.0).astype(np.float32, copy=False)

    def mean(self, values: Rows) -> Rows:
        """Return opacity-weighted means over each pixel's rays [ray, n], [height, width, n]."""
        total = np.maximum(self._sum(self.hits.opacity), np.float32(1e-12))
        return (self._sum(values * self.hits.opacity) / total).astype(np.float32, copy=False)

    def picture(self, values: Rows) -> Rows:
        """Return `values` [pixel, n] of the pixels that rays hit, in their order, [height, width, n]."""
        image = np.zeros((self.camera.height * self.camera.width, values.shape[1]), np.float32)
        image[np.unique(self.pixel)] = values
        return image.reshape(self.camera.height, self.camera.width, -1)

    def _sum(self, values: Rows) -> Rows:
        size = self.camera.height * self.camera.width
        sums = [np.bincount(self.pixel, values[:, i], size) for i in range(values.shape[1])]
        image = np.stack(sums, axis=-1).astype(np.float32)
        return image.reshape(self.camera.height, self.camera.width, values.shape[1])


def look(caches: SurfaceCaches, camera: Camera, antialias: int) -> View:
    """Return the view of `camera` with `antialias` x `antialias` rays for every relevant pixel."""
    origin, direction = camera.rays()
    hits = caches.gbuffer(origin, direction)
    pixel = sub_ray = np.arange(len(origin))
    if antialias > 1:
        covered = (hits.opacity[:, 0] > MIN_OPACITY).reshape(camera.height, camera.width)
        pixel, sub_ray = rays_of_pixels(np.flatnonzero(grown(covered)), camera, antialias)
        origin, direction = camera.finer(antialias).rays()
        origin, direction = origin[sub_ray], direction[sub_ray]
        hits = caches.gbuffer(origin, direction)
    seen = np.flatnonzero(hits.opacity[:, 0] > MIN_OPACITY)
    kept = PrimaryHits(**{field.name: getattr(hits, field.name)[seen] for field in fields(hits)})
    return View(camera, antialias**2, pixel[seen], sub_ray[seen], origin[seen], direction[seen], kept)


def grown(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return `mask` [height, width] with the eight neighbours of every set pixel."""
    rows = mask.copy()
    rows[1:] |= mask[:-1]
    rows[:-1] |= mask[1:]
    grown = rows.copy()
    grown[:, 1:] |= rows[:, :-1]
    grown[:, :-1] |= rows[:, 1:]
    return grown


def rays_of_pixels(
    pixels: NDArray[np.intp], camera: Camera, antialias: int
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return pixel and ray number (in a camera with `antialias` times the pixels) of all rays of `pixels`."""
    row, column = np.divmod(pixels, camera.width)
    offset = np.arange(antialias)
    fine_row = row[:, None, None] * antialias + offset[:, None]
    fine_column = column[:, None, None] * antialias + offset
    ray = fine_row * (camera.width * antialias) + fine_column
    return np.repeat(pixels, antialias**2), ray.reshape(-1)
